// Put in front of every stage by `src/backend/gpu/shaders.rs`: constants and structs shared with the host.

/// Invocations per workgroup. The host sets it for the adapter.
override WORKGROUP: u32 = 8u;

/// One level of a template.
struct Level {
    /// Number of chart pixels.
    pixels: u32,
    /// Number of chunks.
    chunks: u32,
    /// Number of triangles.
    triangles: u32,
    unused: u32,
}

/// A run of pixels of one triangle; one workgroup adds it up.
struct Chunk {
    /// First pixel.
    start: u32,
    /// One past the last pixel.
    end: u32,
    /// The triangle all of them belong to.
    triangle: u32,
    unused: u32,
}

/// The warp of one triangle at one pose: (u, v, 1) relative to the chart's centre to the homogeneous image position
/// relative to an integer base pixel near the warped centre, so that f32 loses nothing to the size of the image.
struct Warp {
    /// First row of the homography; w: the base pixel's u.
    row_u: vec4f,
    /// Second row of the homography; w: the base pixel's v.
    row_v: vec4f,
    /// Third row of the homography; w: 0 for a triangle that is left out, else 1 plus the number of the frame.
    row_w: vec4f,
    /// Factors of the second differences of the template in what sampling adds to it along u; w: gain of what is saturated.
    blur_u: vec4f,
    /// The same along v; w: its bias.
    blur_v: vec4f,
}

/// An image that is scanned.
struct Scan {
    /// Width, pixels.
    width: u32,
    /// Height, pixels.
    height: u32,
    /// Tiles along u.
    columns: u32,
    /// Side of a tile, pixels.
    tile: u32,
}

/// One step of the pyramids of some frames, one after the other. Rows hold four pixels per word and are padded.
struct Halving {
    /// Words per row of the larger image.
    stride_in: u32,
    /// Words per row of the smaller image.
    stride_out: u32,
    /// Words of a row of the smaller image that hold pixels.
    words: u32,
    /// Rows of the smaller image.
    rows: u32,
    /// Rows of the larger image.
    rows_in: u32,
}
