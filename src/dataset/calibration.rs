//! Camera calibrations in the YAML of `OpenCV` (`%YAML:1.0`, `!!opencv-matrix`), which ROS camera files resemble.

use std::path::Path;

use serde::Deserialize;

use super::file::read_text;
use crate::error::{Error, Result};
use crate::geometry::{Camera, Distortion};

/// The fields used; a calibration file may hold many more.
#[derive(Debug, Deserialize)]
struct Calibration {
    image_width: u32,
    image_height: u32,
    #[serde(alias = "cameraMatrix", alias = "Camera_Matrix")]
    camera_matrix: Matrix,
    #[serde(alias = "distCoeffs", alias = "Distortion_Coefficients")]
    distortion_coefficients: Option<Matrix>,
    /// ROS names the lens model.
    distortion_model: Option<String>,
    /// The calibration sample of `OpenCV` marks fisheye lenses.
    fisheye_model: Option<i64>,
}

/// `!!opencv-matrix`, row-major.
#[derive(Debug, Deserialize)]
struct Matrix {
    rows: usize,
    cols: usize,
    data: Vec<f64>,
}

/// Reads a calibration.
///
/// # Errors
/// [`Error::Io`]; [`Error::Line`] for YAML that does not parse or lacks a field; [`Error::Field`] for a lens
/// model other than Brown-Conrady with at most k3, or numbers that describe no camera.
pub fn read(path: &Path) -> Result<Camera> {
    let text = without_directive(read_text(path)?);
    let calibration: Calibration = serde_saphyr::from_str(&text).map_err(|e| {
        let line = e.location().map_or(1, |l| u64::from(u32::try_from(l.line()).unwrap_or(u32::MAX)));
        let remedy =
            "write image_width, image_height, camera_matrix and distortion_coefficients as OpenCV does";
        Error::line(path, line, e.without_snippet().to_string(), remedy)
    })?;
    camera(path, &calibration)
}

/// `OpenCV` begins with `%YAML:1.0`, which is no YAML directive. The line is emptied, not removed, so that the
/// parser still counts lines as the file does.
fn without_directive(text: String) -> String {
    if !text.starts_with("%YAML") {
        return text;
    }
    text.find('\n').map_or_else(String::new, |end| text[end..].to_owned())
}

fn camera(path: &Path, calibration: &Calibration) -> Result<Camera> {
    let k = &calibration.camera_matrix;
    let k: [f64; 9] =
        k.data.as_slice().try_into().ok().filter(|_| (k.rows, k.cols) == (3, 3)).ok_or_else(|| {
            let problem = format!("{}x{} with {} numbers instead of 3x3", k.rows, k.cols, k.data.len());
            Error::field(path, "camera_matrix", problem, "write the 3x3 matrix K")
        })?;
    let model = calibration.distortion_model.as_deref().unwrap_or("plumb_bob");
    let is_polynomial = matches!(model, "plumb_bob" | "rational_polynomial");
    if !is_polynomial || calibration.fisheye_model.is_some_and(|flag| flag != 0) {
        let remedy = "calibrate with the Brown-Conrady model (k1, k2, p1, p2, k3)";
        return Err(Error::field(path, "distortion_model", "fisheye lenses are not supported", remedy));
    }
    let coefficients = calibration.distortion_coefficients.as_ref().map_or(&[][..], |m| &m.data);
    let distortion = distortion(coefficients).map_err(|e| e.in_field(path, "distortion_coefficients"))?;
    let size = (calibration.image_width, calibration.image_height);
    camera_from_matrix(&k, size, distortion).map_err(|e| e.in_field(path, "camera_matrix"))
}

/// A camera from K (row-major), the image size (width, height) in pixels, and the lens.
///
/// # Errors
/// [`Error::Invalid`] if K has skew or is no intrinsic matrix, or a number is out of range.
pub fn camera_from_matrix(k: &[f64; 9], size: (u32, u32), distortion: Distortion) -> Result<Camera> {
    let [fx, skew, cx, zero_10, fy, cy, zero_20, zero_21, one] = *k;
    // Written so that NaN fails too.
    let is_intrinsic =
        skew.is_finite() && zero_10.abs() < 1e-9 && zero_20.abs() < 1e-9 && zero_21.abs() < 1e-9;
    if !(is_intrinsic && (one - 1.0).abs() < 1e-9) {
        let problem = format!("{k:?} is no intrinsic matrix");
        return Err(Error::invalid("K", problem, "write [fx 0 cx, 0 fy cy, 0 0 1], row-major"));
    }
    if skew.abs() > 1e-6 * fx.abs() {
        return Err(Error::invalid("K", format!("skew {skew} is not supported"), "calibrate without skew"));
    }
    let camera = Camera { distortion, ..Camera::pinhole(fx, fy, cx, cy, size.0, size.1) };
    camera.validate()?;
    Ok(camera)
}

/// The lens from the coefficients k1, k2, p1, p2[, k3[, k4, ...]]; an empty list is no distortion.
///
/// # Errors
/// [`Error::Invalid`] for 1 to 3 coefficients, or non-zero ones after k3 (rational, prism, tilted models).
pub fn distortion(coefficients: &[f64]) -> Result<Distortion> {
    let what = "lens distortion";
    if (1..4).contains(&coefficients.len()) {
        let problem = format!("{} coefficients", coefficients.len());
        return Err(Error::invalid(what, problem, "give k1, k2, p1, p2 and optionally k3"));
    }
    if coefficients.iter().skip(5).any(|&c| c != 0.0) {
        let problem =
            "coefficients after k3 are not zero: the rational, prism and tilted models are not supported";
        return Err(Error::invalid(what, problem, "calibrate with k1, k2, p1, p2, k3 only"));
    }
    let at = |k: usize| coefficients.get(k).copied().unwrap_or(0.0);
    Ok(Distortion { k1: at(0), k2: at(1), p1: at(2), p2: at(3), k3: at(4) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::damage::{damaged, with_file};
    use proptest::prelude::*;

    const OPENCV: &[u8] = br#"%YAML:1.0
---
calibration_time: "Mon 01 Jan 2024 10:00:00 AM UTC"
nframes: 25
image_width: 640
image_height: 480
square_size: 2.5000000000000001e-02
# flags: +zero_tangent_dist
flags: 8
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 8.1234567890123456e+02, 0., 3.195e+02, 0.,
       8.2e+02, 2.395e+02, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.5e-01, 1.e-01, 1.e-03, -2.e-03, 0. ]
avg_reprojection_error: 3.1e-01
"#;

    fn variant(from: &str, to: &str) -> Result<Camera> {
        let text = String::from_utf8(OPENCV.to_vec()).unwrap();
        assert!(text.contains(from), "{from} is in the sample");
        with_file("c.yml", text.replace(from, to).as_bytes(), read)
    }

    #[test]
    fn reads_opencv() {
        let camera = with_file("c.yml", OPENCV, read).unwrap();
        let distortion = Distortion { k1: -0.25, k2: 0.1, p1: 0.001, p2: -0.002, k3: 0.0 };
        let fx = 812.345_678_901_234_6;
        let expected = Camera { distortion, ..Camera::pinhole(fx, 820.0, 319.5, 239.5, 640, 480) };
        assert_eq!(camera, expected, "every number");
    }

    #[test]
    fn reads_ros_and_four_or_eight_coefficients() {
        let ros =
            b"image_width: 640\nimage_height: 480\ncamera_name: c\ncamera_matrix:\n  rows: 3\n  cols: 3\n\
                    \x20 data: [800, 0, 320, 0, 801, 240, 0, 0, 1]\ndistortion_model: plumb_bob\n";
        let camera = with_file("c.yaml", ros, read).unwrap();
        assert_eq!(camera, Camera::pinhole(800.0, 801.0, 320.0, 240.0, 640, 480), "no distortion given");
        assert!(variant("-2.e-03, 0. ]", "-2.e-03 ]").is_ok(), "four coefficients");
        assert!(variant("-2.e-03, 0. ]", "-2.e-03, 0., 0., 0., 0. ]").is_ok(), "eight, the last three zero");
    }

    #[test]
    fn errors_name_field_or_line() {
        let cases = [
            ("-2.e-03, 0. ]", "-2.e-03, 0., 0.3, 0., 0. ]", "distortion_coefficients"),
            ("1.e-01, 1.e-03, -2.e-03, 0. ]", "1.e-01 ]", "distortion_coefficients"),
            ("image_width: 640\n", "", "image_width"),
            ("image_width: 640", "image_width: many", "c.yml:5:"),
            ("0., 0., 1. ]", "0., 0. ]", "camera_matrix"),
            ("8.2e+02", "-8.2e+02", "focal lengths"),
            ("8.2e+02", ".Nan", "camera_matrix"),
            ("0., 3.195e+02", "2., 3.195e+02", "skew"),
            ("flags: 8", "fisheye_model: 1", "fisheye"),
            ("flags: 8", "flags: [", "c.yml:"),
        ];
        let failed: Vec<String> = cases
            .iter()
            .filter_map(|(from, to, expected)| match variant(from, to) {
                Ok(_) => Some(format!("{to:?} was accepted")),
                Err(e) => (!e.to_string().contains(expected)).then(|| format!("{to:?}: {e}")),
            })
            .collect();
        assert!(failed.is_empty(), "{failed:#?}");
    }

    proptest! {
        #[test]
        fn no_damaged_file_panics(bytes in damaged(OPENCV)) {
            let _ = with_file("c.yml", &bytes, read);
        }
    }
}
