// How the stages that add up chunks of charts read and sum on a real GPU: tables are buffers, and the sums of a workgroup
// meet in its shared memory. The other way: `on_software.wgsl`.

@group(0) @binding(1) var<storage, read> chunks: array<Chunk>;
@group(0) @binding(2) var<storage, read> pixels: array<vec4u>;
@group(0) @binding(3) var<storage, read> modes: array<vec2u>;
@group(1) @binding(0) var<storage, read> warps: array<Warp>;
@group(1) @binding(1) var<storage, read> appearance: array<vec4f>;

/// Invocations whose sums one invocation adds up in the first step of a reduction.
const REDUCE: u32 = 8u;

var<workgroup> partial: array<vec4f, WORKGROUP * SUM_PLANES>;

fn chunk_at(i: u32) -> Chunk {
    return chunks[i];
}

fn pixel_at(i: u32) -> vec4u {
    return pixels[i];
}

fn packed_modes_at(plane: u32, p: u32) -> vec2u {
    return modes[plane * level.pixels + p];
}

fn warp_at(i: u32) -> Warp {
    return warps[i];
}

fn appearance_at(i: u32) -> vec4f {
    return appearance[i];
}

/// Where an invocation puts its first plane of sums.
fn first_plane(lane: u32, row: u32) -> u32 {
    return lane * SUM_PLANES;
}

fn put(plane: u32, sum: vec4f) {
    partial[plane] = sum;
}

/// Adds up the workgroup's sums in a fixed order and writes them to the row. Every invocation has to come here.
fn finish(lane: u32, row: u32, write: bool) {
    let start = row * SUM_PLANES;
    workgroupBarrier();
    for (var i = lane; i < SUM_PLANES * (WORKGROUP / REDUCE); i += WORKGROUP) {
        let first = (i / SUM_PLANES) * REDUCE * SUM_PLANES + i % SUM_PLANES;
        var sum = partial[first];
        for (var k = 1u; k < REDUCE; k++) {
            sum += partial[first + k * SUM_PLANES];
        }
        if (WORKGROUP > REDUCE) {
            partial[first] = sum;
        } else if (write) {
            sums[start + i] = sum;
        }
    }
    if (WORKGROUP > REDUCE) {
        workgroupBarrier();
        for (var i = lane; write && i < SUM_PLANES; i += WORKGROUP) {
            var sum = partial[i];
            for (var k = REDUCE; k < WORKGROUP; k += REDUCE) {
                sum += partial[k * SUM_PLANES + i];
            }
            sums[start + i] = sum;
        }
    }
}
