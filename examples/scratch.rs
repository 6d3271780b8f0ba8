#![allow(warnings)]
use aam6d::{align::*, backend::*, geometry::*, model::*, track::*, train::*, *};
use nalgebra::*;
use std::collections::BTreeMap;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let set = &args[1];
    let scene = &args[2];
    let frames: Vec<u32> = args[3].split(',').map(|x| x.parse().unwrap()).collect();
    let reff = args.get(4).map(|s| s.as_str()).unwrap_or("scene_ref.json");
    let modes: usize = args.get(5).map(|s| s.parse().unwrap()).unwrap_or(0);
    let root = format!("{set}");
    let sc = format!("{root}/test/{scene}");
    let j: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(format!("{sc}/{reff}")).unwrap()).unwrap();
    let c: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(format!("{sc}/scene_camera.json")).unwrap()).unwrap();
    let mut poses = BTreeMap::new();
    for (k, v) in j.as_object().unwrap() {
        let r: Vec<f64> = v[0]["cam_R_m2c"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        let t: Vec<f64> =
            v[0]["cam_t_m2c"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap() / 1000.0).collect();
        poses.insert(
            k.parse::<u32>().unwrap(),
            Pose::from_matrix(&Matrix3::from_row_slice(&r), Vector3::from_row_slice(&t)).unwrap(),
        );
    }
    let k: Vec<f64> = c["0"]["cam_K"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
    let cam = Camera::pinhole(k[0], k[4], k[2], k[5], 640, 480);
    let ply = std::fs::read_to_string(format!("{root}/models/obj_000001.ply")).unwrap();
    let mut nv = 0;
    let mut nf = 0;
    let mut lines = ply.lines();
    for l in lines.by_ref() {
        if let Some(x) = l.strip_prefix("element vertex ") {
            nv = x.parse().unwrap();
        }
        if let Some(x) = l.strip_prefix("element face ") {
            nf = x.parse().unwrap();
        }
        if l == "end_header" {
            break;
        }
    }
    let mut mesh = TriangleMesh::default();
    for _ in 0..nv {
        let v: Vec<f64> = lines.next().unwrap().split_whitespace().map(|x| x.parse().unwrap()).collect();
        mesh.vertices.push(Point3::new(v[0], v[1], v[2]) / 1000.0);
    }
    for _ in 0..nf {
        let v: Vec<u32> = lines.next().unwrap().split_whitespace().map(|x| x.parse().unwrap()).collect();
        mesh.triangles.push([v[1], v[2], v[3]]);
    }
    let img = |i: u32| imaging::gray::read(std::path::Path::new(&format!("{sc}/gray/{i:06}.png"))).unwrap();
    let tr: Vec<TrainingImage> = frames
        .iter()
        .map(|&i| TrainingImage { image: img(i), camera: cam, camera_from_object: poses[&i] })
        .collect();
    let t0 = std::time::Instant::now();
    let model = train(&mesh, &tr, &TrainOptions { modes, ..Default::default() }).unwrap();
    println!(
        "train {:?} triangles {} px {:?}",
        t0.elapsed(),
        model.shape.triangles(),
        model.levels.iter().map(|l| l.pixels.len()).collect::<Vec<_>>()
    );
    let corners = model.shape.corners;
    let ctr = Point3::from((corners[0].coords + corners[7].coords) / 2.0);
    let mut tk =
        Tracker::new(model, cam, Box::new(CpuBackend::new()), Box::new(InverseCompositional::default()))
            .unwrap();
    tk.start_at(poses.values().next().copied().unwrap());
    let (mut px, mut mm, mut deg, mut it, mut ms, mut nees) =
        (vec![], vec![], vec![], vec![], vec![], vec![]);
    let mut lost = 0;
    let mut minc = (1.0f64, 1.0f64);
    let mut rel_mm = vec![];
    let mut rel_deg = vec![];
    let mut first = None;
    for (i, truth) in &poses {
        let r = tk.track(&img(*i)).unwrap();
        let e = r.estimate.camera_from_object;
        if r.status == Status::Lost {
            lost += 1;
        }
        minc = (minc.0.min(r.estimate.score.correlation), minc.1.min(r.estimate.score.recognised));
        let d: f64 = corners
            .iter()
            .map(|x| {
                (cam.project(&e.transform_point(x)).unwrap()
                    - cam.project(&truth.transform_point(x)).unwrap())
                .norm_squared()
            })
            .sum::<f64>()
            / 8.0;
        px.push(d.sqrt());
        mm.push((e.transform_point(&ctr) - truth.transform_point(&ctr)).norm() * 1e3);
        deg.push(e.compose(&truth.inverse()).rotation_vector().norm().to_degrees());
        it.push(r.estimate.iterations as f64);
        ms.push(r.time_ms);
        let f = *first.get_or_insert((e, *truth));
        let (re, rt) = (e.compose(&f.0.inverse()), truth.compose(&f.1.inverse()));
        let c0 = f.1.transform_point(&ctr);
        rel_mm.push((re.transform_point(&c0) - rt.transform_point(&c0)).norm() * 1e3);
        rel_deg.push(re.compose(&rt.inverse()).rotation_vector().norm().to_degrees());
        let c = tk.model().shape.centre;
        let err = e.inverse().compose(truth); // increment
        let w = err.rotation_vector();
        let t = err.transform_point(&c) - c;
        let v = Vector6::new(t.x, t.y, t.z, w.x, w.y, w.z);
        if let Some(inv) = r.estimate.covariance.try_inverse() {
            nees.push(v.dot(&(inv * v)));
        }
    }
    let st = |v: &mut Vec<f64>| {
        v.sort_by(f64::total_cmp);
        let n = v.len();
        format!(
            "rms {:.4} med {:.4} p95 {:.4} max {:.4}",
            (v.iter().map(|x| x * x).sum::<f64>() / n as f64).sqrt(),
            v[n / 2],
            v[(n * 95 / 100).min(n - 1)],
            v[n - 1]
        )
    };
    println!(
        "lost {lost}/{} mincorr {minc:?}\n px {}\n mm {}\n deg {}\n it {}\n ms {}\n nees {}\n relmm {}\n reldeg {}",
        poses.len(),
        st(&mut px),
        st(&mut mm),
        st(&mut deg),
        st(&mut it),
        st(&mut ms),
        st(&mut nees),
        st(&mut rel_mm),
        st(&mut rel_deg)
    );
}
