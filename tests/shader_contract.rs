//! Does every shader validate and agree with the host on layouts, names and constants? Needs no adapter.

use std::collections::BTreeMap;
use std::mem::offset_of;

use aam6d::backend::gpu::buffers::{Chunk, Halving, Level, Scan, Warp};
use aam6d::backend::gpu::shaders::{
    ACCUMULATE, AdapterClass, DOWNSAMPLE, Kind, LINEARIZE, Partition, REDUCE, SCAN, Stage, TABLE_WIDTH,
    WORKGROUP_BYTES, accumulate_planes, linearize_planes,
};
use aam6d::backend::{SATURATED, SATURATED_SHARE, TEMPLATE_BLUR};
use aam6d::model::steps;
use naga::valid::{Capabilities, ValidationFlags, Validator};
use naga::{AddressSpace, Expression, ImageClass, Literal, Module, ScalarKind, StorageAccess, TypeInner};

const STAGES: [Stage; 4] = [DOWNSAMPLE, ACCUMULATE, LINEARIZE, SCAN];
const CLASSES: [AdapterClass; 2] = [AdapterClass::Gpu, AdapterClass::Software];
/// A stage and its planes of sums by mode planes.
type ChartStage = (Stage, fn(u32) -> u32);

/// The stages that add up chunks of charts, and how many planes of sums the host thinks they have.
const CHART_STAGES: [ChartStage; 2] = [(ACCUMULATE, accumulate_planes), (LINEARIZE, linearize_planes)];
const MODE_PLANES: [u32; 6] = [0, 1, 2, 3, 4, 16];

fn variants() -> impl Iterator<Item = (AdapterClass, u32)> {
    CLASSES.into_iter().flat_map(|class| MODE_PLANES.map(|mode_planes| (class, mode_planes)))
}

fn parse(text: &str) -> Module {
    let module = naga::front::wgsl::parse_str(text).unwrap_or_else(|e| panic!("{}", e.emit_to_string(text)));
    // No capability beyond WebGPU's core, so that every adapter takes the shaders.
    let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
    if let Err(error) = validator.validate(&module) {
        panic!("{}", error.emit_to_string(text));
    }
    module
}

/// The module with the pipeline constant set.
fn with_workgroup(stage: &Stage, partition: Partition, mode_planes: u32, workgroup: u32) -> Module {
    let text = stage.text(partition.class, mode_planes);
    let constant =
        text.replace("override WORKGROUP: u32 = 8u;", &format!("const WORKGROUP: u32 = {workgroup}u;"));
    assert_ne!(text, constant, "{}: WORKGROUP is not where it was", stage.name);
    parse(&constant)
}

#[test]
fn shaders_validate_and_are_named_after_their_stage() {
    for stage in STAGES {
        for (class, mode_planes) in variants() {
            let module = parse(&stage.text(class, mode_planes));
            let entries: Vec<_> = module.entry_points.iter().map(|e| e.name.as_str()).collect();
            assert_eq!(entries, [stage.name], "one entry point, named as the stage");
        }
        for folder in ["shaders/{}.wgsl", "src/backend/cpu/{}.rs"] {
            let path = folder.replace("{}", stage.name);
            let full = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(&path);
            assert!(full.is_file(), "{path} is missing");
        }
    }
}

/// Name, offset and size of every field, and the size of the struct, as WGSL lays it out.
type Layout = (Vec<(String, usize, usize)>, usize);

fn device_layout(module: &Module, name: &str) -> Layout {
    let find = |(_, ty): (_, &naga::Type)| match &ty.inner {
        TypeInner::Struct { members, span } if ty.name.as_deref() == Some(name) => {
            Some((members.clone(), *span))
        }
        _ => None,
    };
    let (members, span) = module.types.iter().find_map(find).unwrap_or_else(|| panic!("no struct {name}"));
    let field = |m: &naga::StructMember| {
        let size = module.types[m.ty].inner.size(module.to_ctx());
        (m.name.clone().unwrap_or_default(), m.offset as usize, size as usize)
    };
    (members.iter().map(field).collect(), span as usize)
}

macro_rules! host_layout {
    ($name:ident { $($field:ident),* }) => {{
        let zero: $name = bytemuck::Zeroable::zeroed();
        let fields = vec![$((stringify!($field).to_owned(), offset_of!($name, $field), size_of_val(&zero.$field))),*];
        (stringify!($name), (fields, size_of::<$name>()))
    }};
}

fn host_layouts() -> Vec<(&'static str, Layout)> {
    vec![
        host_layout!(Level { pixels, chunks, triangles, unused }),
        host_layout!(Chunk { start, end, triangle, unused }),
        host_layout!(Warp { row_u, row_v, row_w, blur_u, blur_v }),
        host_layout!(Scan { width, height, columns, tile }),
        host_layout!(Halving { stride_in, stride_out, words, rows, rows_in }),
    ]
}

#[test]
fn structs_have_the_same_fields_on_both_sides() {
    let module = parse(&ACCUMULATE.text(AdapterClass::Gpu, 1));
    for (name, host) in host_layouts() {
        assert_eq!(host, device_layout(&module, name), "{name}: host and device");
    }
    let structs = module.types.iter().filter(|(_, ty)| matches!(ty.inner, TypeInner::Struct { .. }));
    assert_eq!(structs.count(), host_layouts().len(), "every WGSL struct is compared");
}

#[test]
fn a_changed_struct_is_noticed() {
    let changed = ACCUMULATE.text(AdapterClass::Gpu, 1).replace("row_u: vec4f", "row_u: vec3f");
    let layout =
        device_layout(&parse(&changed.replace("warp.row_u.w", "0.0").replace("row_u.xyz", "row_u")), "Warp");
    let (_, host) = host_layouts().remove(2);
    assert_ne!(host, layout, "vec3f in place of vec4f must show");
}

fn kind(module: &Module, variable: &naga::GlobalVariable) -> Kind {
    match (variable.space, &module.types[variable.ty].inner) {
        (AddressSpace::Uniform, _) => Kind::Uniform,
        (AddressSpace::Storage { access }, _) if access.contains(StorageAccess::STORE) => Kind::Write,
        (AddressSpace::Storage { .. }, _) => Kind::Read,
        (_, TypeInner::Sampler { .. }) => Kind::Sampler,
        (_, TypeInner::Image { class: ImageClass::Sampled { kind: ScalarKind::Uint, .. }, .. }) => {
            Kind::Table
        }
        _ => Kind::Image,
    }
}

/// As what a shader declares it.
fn seen(kind: Kind, class: AdapterClass) -> Kind {
    if (kind, class) == (Kind::Table, AdapterClass::Gpu) { Kind::Read } else { kind }
}

#[test]
fn bindings_are_the_ones_the_host_makes() {
    for (stage, class) in STAGES.into_iter().flat_map(|stage| CLASSES.map(|class| (stage, class))) {
        let module = parse(&stage.text(class, 1));
        let device: BTreeMap<_, _> = module
            .global_variables
            .iter()
            .filter_map(|(_, v)| v.binding.map(|b| (b, v)))
            .map(|(b, v)| ((b.group, b.binding), (v.name.clone().unwrap_or_default(), kind(&module, v))))
            .collect();
        let of_group = |(group, bindings): (u32, &&[(&str, Kind)])| {
            let named = (0..)
                .zip(*bindings)
                .map(move |(b, (name, kind))| ((group, b), ((*name).to_owned(), seen(*kind, class))));
            named.collect::<Vec<_>>()
        };
        let host: BTreeMap<_, _> = (0..).zip(stage.groups).flat_map(of_group).collect();
        assert_eq!(host, device, "{} on {class:?}: host and device", stage.name);
    }
}

fn constants_of((stage, planes): ChartStage, class: AdapterClass, mode_planes: u32) {
    let module = parse(&stage.text(class, mode_planes));
    let value = |name: &str| {
        let (_, constant) = module
            .constants
            .iter()
            .find(|(_, c)| c.name.as_deref() == Some(name))
            .unwrap_or_else(|| panic!("no constant {name}"));
        match module.global_expressions[constant.init] {
            Expression::Literal(Literal::U32(value)) => value,
            ref other => panic!("{name} is {other:?}"),
        }
    };
    assert_eq!(value("MODE_PLANES"), mode_planes, "MODE_PLANES");
    assert_eq!(value("SUM_PLANES"), planes(mode_planes), "SUM_PLANES of {}", stage.name);
    match class {
        AdapterClass::Gpu => assert_eq!(value("REDUCE"), REDUCE, "REDUCE"),
        AdapterClass::Software => assert_eq!(value("TABLE_WIDTH"), TABLE_WIDTH, "TABLE_WIDTH"),
    }
}

/// The values of a shader's constants, by their text: constants that are products of others are not literals.
#[test]
fn numbers_of_the_template_agree() {
    let text = ACCUMULATE.text(AdapterClass::Gpu, 1);
    let says = |name: &str, value: String| {
        let line = format!("const {name}: f32 = {value};");
        assert!(text.contains(&line), "the shader has no `{line}`");
    };
    says("TEMPLATE_BLUR", format!("1.0 / {:?}", 1.0 / TEMPLATE_BLUR));
    says("SATURATED", format!("{:?}", f32::from(SATURATED)));
    says("SATURATED_SHARE", format!("{SATURATED_SHARE:?}"));
    says("SIGNED_STEP", format!("1.0 / {:?}", 1.0 / steps::SIGNED));
    says("INTENSITY_STEP", format!("1.0 / {:?}", 1.0 / steps::INTENSITY));
    says("WEIGHT_STEP", format!("1.0 / {:?}", 1.0 / steps::WEIGHT));
}

#[test]
fn constants_agree() {
    for (class, mode_planes) in variants() {
        CHART_STAGES.into_iter().for_each(|stage| constants_of(stage, class, mode_planes));
    }
}

fn workgroup_of((stage, planes): ChartStage, partition: Partition, mode_planes: u32) {
    let workgroup = partition.workgroup_for(planes(mode_planes));
    assert!(workgroup.is_multiple_of(REDUCE) && workgroup <= 256, "workgroups of {workgroup}");
    let module = with_workgroup(&stage, partition, mode_planes, workgroup);
    assert_eq!(module.entry_points[0].workgroup_size, [workgroup, 1, 1], "workgroup size");
    let shared: u32 = module
        .global_variables
        .iter()
        .filter(|(_, v)| v.space == AddressSpace::WorkGroup)
        .map(|(_, v)| module.types[v.ty].inner.size(module.to_ctx()))
        .sum();
    let name = stage.name;
    let expected = partition.shared_bytes(workgroup, planes(mode_planes));
    assert_eq!(shared, expected, "{name}: the host knows what is shared");
    assert!(
        shared <= WORKGROUP_BYTES,
        "{name}: {shared} bytes shared by {workgroup}, {mode_planes} mode planes"
    );
}

#[test]
fn workgroups_fit_every_device() {
    for is_software in [false, true] {
        let partition = Partition::of_adapter(is_software);
        for mode_planes in MODE_PLANES {
            CHART_STAGES.into_iter().for_each(|stage| workgroup_of(stage, partition, mode_planes));
        }
        let module = with_workgroup(&DOWNSAMPLE, partition, 0, partition.workgroup);
        assert_eq!(module.entry_points[0].workgroup_size, [partition.workgroup, 1, 1], "workgroup size");
    }
}
