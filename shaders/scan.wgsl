// Stage `scan`: sparse templates of a normalised gradient at every position of an image, the best position per tile.
// Twin: `src/backend/cpu/scan.rs`.

@group(0) @binding(0) var<uniform> scanned: Scan;
@group(0) @binding(1) var<storage, read> gradient: array<vec2f>;
/// Offset (xy) and value (zw) of every point.
@group(0) @binding(2) var<storage, read> points: array<vec4f>;
/// First point, one past the last, bits of the scale, unused: one per template of the dispatch.
@group(0) @binding(3) var<storage, read> templates: array<vec4u>;
/// Bits of the score, and pixel index: tile by tile, template by template.
@group(0) @binding(4) var<storage, read_write> peaks: array<vec2u>;

const LOWEST: f32 = -3.0e38;

var<workgroup> best_score: array<f32, WORKGROUP>;
var<workgroup> best_pixel: array<u32, WORKGROUP>;

/// sum t.F of a template with its anchor at (u, v); points outside the image count 0.
fn agreement(first: u32, end: u32, u: i32, v: i32) -> f32 {
    var sum = 0.0;
    for (var p = first; p < end; p++) {
        let point = points[p];
        let x = u + i32(point.x);
        let y = v + i32(point.y);
        if (x >= 0 && y >= 0 && x < i32(scanned.width) && y < i32(scanned.height)) {
            sum += dot(point.zw, gradient[u32(y) * scanned.width + u32(x)]);
        }
    }
    return sum;
}

/// One workgroup per tile and template.
@compute @workgroup_size(WORKGROUP)
fn scan(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) invocation: u32) {
    let range = templates[group.y];
    let left = (group.x % scanned.columns) * scanned.tile;
    let top = (group.x / scanned.columns) * scanned.tile;
    let width = min(scanned.tile, scanned.width - left);
    let height = min(scanned.tile, scanned.height - top);
    var score = LOWEST;
    var pixel = 0u;
    for (var i = invocation; i < width * height; i += WORKGROUP) {
        let u = left + i % width;
        let v = top + i / width;
        let found = agreement(range.x, range.y, i32(u), i32(v)) * bitcast<f32>(range.z);
        if (found > score) {
            score = found;
            pixel = v * scanned.width + u;
        }
    }
    best_score[invocation] = score;
    best_pixel[invocation] = pixel;
    workgroupBarrier();
    if (invocation == 0u) {
        for (var k = 1u; k < WORKGROUP; k++) {
            let earlier = best_score[k] == score && best_pixel[k] < pixel;
            if (best_score[k] > score || earlier) {
                score = best_score[k];
                pixel = best_pixel[k];
            }
        }
        let tiles = scanned.columns * ((scanned.height + scanned.tile - 1u) / scanned.tile);
        peaks[group.y * tiles + group.x] = vec2u(bitcast<u32>(score), pixel);
    }
}
