//! Table 1 of the paper, as printed: another object, another camera, another robot.

use serde::{Deserialize, Serialize};

use crate::eval::ErrorStatistics;

/// Where the numbers come from.
pub(super) const SOURCE: &str = "P. Mittrapiyanuruk, G. N. DeSouza, Tracking 3D pose of rigid objects using \
     Inverse Compositional Active Appearance Models, KES Journal 14 (2010) 229-239, DOI 10.3233/KES-2010-0204, Table 1";

/// The three methods that the paper compares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Published {
    /// The paper's own method.
    Proposed,
    /// The previous method [15].
    Previous,
    /// The geometric method [19].
    Geometric,
}

/// All three in the paper's order.
pub(super) const ALL: [Published; 3] = [Published::Proposed, Published::Previous, Published::Geometric];

impl Published {
    /// The name in the paper's table.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Proposed => "proposed method",
            Self::Previous => "previous method [15]",
            Self::Geometric => "geometric method [19]",
        }
    }
}

/// Averages, standard deviations, maxima; each x y z (mm) and rx ry rz (degrees).
type Printed = [[f64; 6]; 3];

/// The printed rows of a sequence (1 or 2).
fn printed(sequence: u32, method: Published) -> Option<Printed> {
    Some(match (sequence, method) {
        (1, Published::Proposed) => [
            [6.3, 5.2, 2.9, 0.33, 0.37, 0.14],
            [5.5, 5.7, 3.1, 0.31, 0.43, 0.12],
            [26.5, 23.1, 13.4, 1.27, 1.71, 0.49],
        ],
        (1, Published::Previous) => [
            [6.9, 5.4, 2.9, 0.34, 0.40, 0.14],
            [5.6, 5.8, 3.1, 0.31, 0.43, 0.13],
            [25.2, 23.1, 13.5, 1.17, 1.66, 0.51],
        ],
        (1, Published::Geometric) => [
            [11.2, 8.1, 3.4, 0.51, 0.76, 0.27],
            [9.1, 7.1, 3.7, 0.43, 0.55, 0.22],
            [48.8, 37.2, 31.8, 2.26, 3.06, 1.04],
        ],
        (2, Published::Proposed) => [
            [6.2, 5.5, 3.5, 0.34, 0.47, 0.12],
            [5.5, 5.6, 3.5, 0.32, 0.38, 0.13],
            [25.5, 21.0, 17.2, 1.41, 1.88, 0.57],
        ],
        (2, Published::Previous) => [
            [5.5, 5.5, 3.6, 0.34, 0.45, 0.14],
            [5.9, 5.9, 3.4, 0.32, 0.39, 0.13],
            [23.6, 22.1, 16.5, 1.27, 1.74, 0.52],
        ],
        (2, Published::Geometric) => [
            [14.9, 7.9, 4.2, 0.48, 0.96, 0.23],
            [11.1, 6.4, 4.5, 0.39, 0.80, 0.18],
            [52.1, 29.2, 23.0, 1.64, 3.77, 1.00],
        ],
        _ => return None,
    })
}

/// The printed errors of a method in a sequence: x y z in millimetres, rx ry rz in degrees.
pub(super) fn errors(sequence: u32, method: Published) -> Option<[ErrorStatistics; 6]> {
    let [avg, std, max] = printed(sequence, method)?;
    Some(std::array::from_fn(|k| ErrorStatistics { avg: Some(avg[k]), std: Some(std[k]), max: Some(max[k]) }))
}
