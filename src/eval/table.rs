//! The evaluation as a table for people.

use std::fmt::{self, Display, Formatter};

use super::report::Evaluation;
use super::robot::RobotErrors;
use super::statistics::ErrorStatistics;

impl Display for Evaluation {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        writeln!(f, "frames {}, lost {} (without an estimate {})", self.frames, self.lost, self.missing)?;
        if self.without_truth > 0 {
            writeln!(f, "not judged: {} estimates of frames without truth", self.without_truth)?;
        }
        writeln!(f, "{:<24}{:>10}{:>10}{:>10}", "error of tracked frames", "avg", "std", "max")?;
        let (t, r) = (&self.translation_mm, &self.rotation_deg);
        axis(f, "translation x (right)", &t.x, "mm")?;
        axis(f, "translation y (down)", &t.y, "mm")?;
        axis(f, "translation z (depth)", &t.z, "mm")?;
        axis(f, "rotation about x", &r.x, "deg")?;
        axis(f, "rotation about y", &r.y, "deg")?;
        axis(f, "rotation about z", &r.z, "deg")?;
        line(f, "rms", &[("", self.rms_t_mm, "mm"), ("", self.rms_r_deg, "deg")])?;
        line(f, "ADD", &[("median", self.add_mm.median, "mm"), ("95 %", self.add_mm.p95, "mm")])?;
        let corner = &self.corner_px;
        let values = [("median", corner.median, "px"), ("95 %", corner.p95, "px"), ("max", corner.max, "px")];
        line(f, "corners", &values)?;
        let motion = &self.relative;
        line(f, "motion, median", &[("", motion.t_mm_median, "mm"), ("", motion.r_deg_median, "deg")])?;
        line(f, "jitter", &[("", self.jitter.t_mm, "mm"), ("", self.jitter.r_deg, "deg")])?;
        let time = &self.ms_per_frame;
        line(f, "time per frame", &[("median", time.median, "ms"), ("95 %", time.p95, "ms")])?;
        line(f, "iterations, mean", &[("", self.iterations_mean, "")])?;
        self.robot.as_ref().map_or(Ok(()), |robot| robot_table(f, robot))
    }
}

/// Motion of the end-effector against the robot, eqs. (19) and (20).
fn robot_table(f: &mut Formatter<'_>, robot: &RobotErrors) -> fmt::Result {
    let reference = robot.reference_frame.map_or_else(|| "-".to_owned(), |frame| frame.to_string());
    let title = format!("end-effector, from {reference}");
    writeln!(f, "{title:<24}{:>10}{:>10}{:>10}", "avg", "std", "max")?;
    for (what, axes, unit) in
        [("translation", &robot.translation_mm, "mm"), ("rotation about", &robot.rotation_deg, "deg")]
    {
        for (name, e) in [("x", &axes.x), ("y", &axes.y), ("z", &axes.z)] {
            axis(f, &format!("{what} {name}"), e, unit)?;
        }
    }
    line(f, "rms", &[("", robot.rms_t_mm, "mm"), ("", robot.rms_r_deg, "deg")])
}

/// A number with three decimals, or a dash.
fn shown(value: Option<f64>) -> String {
    value.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}"))
}

fn axis(f: &mut Formatter<'_>, name: &str, e: &ErrorStatistics, unit: &str) -> fmt::Result {
    writeln!(f, "{name:<24}{:>10}{:>10}{:>10} {unit}", shown(e.avg), shown(e.std), shown(e.max))
}

fn line(f: &mut Formatter<'_>, name: &str, values: &[(&str, Option<f64>, &str)]) -> fmt::Result {
    let words = |(what, value, unit): &(&str, Option<f64>, &str)| {
        [*what, &shown(*value), *unit].into_iter().filter(|s| !s.is_empty()).collect::<Vec<_>>().join(" ")
    };
    writeln!(f, "{name:<24}{}", values.iter().map(words).collect::<Vec<_>>().join(", "))
}
