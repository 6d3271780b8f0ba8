//! Statistics over lists of errors; `None` where there is nothing to say.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Statistics of the absolute errors of one degree of freedom, in the unit of the field that holds them.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct ErrorStatistics {
    /// Mean of |e|.
    pub avg: Option<f64>,
    /// Standard deviation of |e| (divided by n).
    pub std: Option<f64>,
    /// Largest |e|.
    pub max: Option<f64>,
}

impl ErrorStatistics {
    /// Of signed errors.
    pub fn of(errors: impl IntoIterator<Item = f64>) -> Self {
        let magnitudes: Vec<f64> = errors.into_iter().map(f64::abs).collect();
        let Some(avg) = mean(&magnitudes) else { return Self::default() };
        let deviations: Vec<f64> = magnitudes.iter().map(|m| m - avg).collect();
        Self { avg: Some(avg), std: rms(&deviations), max: maximum(&magnitudes) }
    }
}

/// Statistics for the three camera axes: x right, y down, z along the view.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PerAxis {
    /// To the right, or about that axis.
    pub x: ErrorStatistics,
    /// Down, or about that axis.
    pub y: ErrorStatistics,
    /// Along the view, or about that axis.
    pub z: ErrorStatistics,
}

impl PerAxis {
    /// Of error vectors.
    pub fn of(errors: &[Vector3<f64>]) -> Self {
        let axis = |k: usize| ErrorStatistics::of(errors.iter().map(|e| e[k]));
        Self { x: axis(0), y: axis(1), z: axis(2) }
    }
}

/// Length of a list as a number to divide by.
fn count(values: &[f64]) -> f64 {
    f64::from(u32::try_from(values.len()).unwrap_or(u32::MAX))
}

/// Arithmetic mean.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / count(values))
}

/// Root mean square.
pub fn rms(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| (values.iter().map(|v| v * v).sum::<f64>() / count(values)).sqrt())
}

/// Largest value.
pub fn maximum(values: &[f64]) -> Option<f64> {
    values.iter().copied().reduce(f64::max)
}

/// The value below which `percent` of the list lies, interpolated between neighbours (numpy's "linear").
pub fn percentile(values: &[f64], percent: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let position = percent.clamp(0.0, 100.0) / 100.0 * (count(&sorted) - 1.0);
    // Finds the neighbours by their ranks, which need no cast from float to index.
    let ranked = || (0_u32..).map(f64::from).zip(sorted.iter().copied());
    let (rank, below) = ranked().take_while(|(rank, _)| *rank <= position).last()?;
    let above = ranked().find(|(rank, _)| *rank >= position).map_or(below, |(_, value)| value);
    Some(below + (position - rank) * (above - below))
}

/// Middle value.
pub fn median(values: &[f64]) -> Option<f64> {
    percentile(values, 50.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        let s = ErrorStatistics::of([1.0, -3.0, 2.0]);
        assert_eq!((s.avg, s.max), (Some(2.0), Some(3.0)), "of magnitudes");
        assert!((s.std.unwrap() - (2.0_f64 / 3.0).sqrt()).abs() < 1e-12, "{s:?}");
        assert_eq!(rms(&[3.0, 4.0]), Some(12.5_f64.sqrt()), "rms");
        let axes = PerAxis::of(&[Vector3::new(1.0, -2.0, 3.0)]);
        assert_eq!((axes.x.avg, axes.y.avg, axes.z.max), (Some(1.0), Some(2.0), Some(3.0)), "per axis");
    }

    #[test]
    fn percentiles_interpolate() {
        let values = [40.0, 10.0, 20.0, 30.0];
        assert_eq!(median(&values), Some(25.0), "between the middle two");
        assert_eq!(percentile(&values, 0.0), Some(10.0), "smallest");
        assert_eq!(percentile(&values, 100.0), Some(40.0), "largest");
        assert!((percentile(&values, 95.0).unwrap() - 38.5).abs() < 1e-12, "numpy gives 38.5");
        assert_eq!(median(&[7.0]), Some(7.0), "one value");
    }

    #[test]
    fn nothing_gives_nothing() {
        assert_eq!(ErrorStatistics::of([]), ErrorStatistics::default(), "no errors");
        assert_eq!((mean(&[]), rms(&[]), maximum(&[]), median(&[])), (None, None, None, None), "empty lists");
    }
}
