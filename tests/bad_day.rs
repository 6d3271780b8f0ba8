//! Light, occlusion, blur, noise, every side of the object, dropped frames: is the pose still right, and does its
//! covariance still tell the truth?

mod support;

use std::sync::LazyLock;

use aam6d::align::Options;
use aam6d::model::Model;
use aam6d::simulate::{SceneKind, Sequence, SequenceOptions};
use aam6d::train::TrainOptions;
use support::day::{Day, follow, follow_with};
use support::tracking::{say, sequence, sixteen, trained};

/// Appearance modes of the models of the relief in changing light.
const MODES: usize = 4;
/// Frames of the track that shows what the triangle weights cost.
const COST_FRAMES: usize = 60;
/// The bound is taken at every so many frames.
const BOUND_EVERY: usize = 27;

/// A track, with the sequence it is of.
struct Case {
    name: &'static str,
    sequence: Sequence,
    day: Day,
}

impl Case {
    fn new(name: &'static str, options: SequenceOptions, model: &Model, step: usize) -> Self {
        let sequence = Sequence::new(options).expect("good options");
        let day = follow(&sequence, model, (0..options.frames).step_by(step));
        let case = Self { name, sequence, day };
        case.say();
        case
    }

    fn say(&self) {
        let (day, [mm, degrees]) = (&self.day, self.day.rms());
        say(format_args!(
            "{}: {} of {} lost, rms {mm:.4} mm, {degrees:.4} deg, median {:.4} mm, corners {:.3} px (95 %), \
             normalised error squared {:.2}",
            self.name,
            day.lost(),
            day.tracked.len(),
            day.median_mm(&self.sequence),
            day.p95_px(),
            day.consistency()
        ));
    }

    /// Nothing is lost and the error is at most so many millimetres (rms).
    fn check(&self, most_mm: f64) {
        let (lost, [mm, _]) = (self.day.lost(), self.day.rms());
        assert!(lost == 0 && mm <= most_mm, "{}: {lost} lost, {mm} mm", self.name);
    }

    /// The errors are at most so many times the bound.
    fn check_bound(&self, most: f64) {
        let [t, r] = self.day.efficiency(&self.sequence, BOUND_EVERY);
        say(format_args!("{}: {t:.2} and {r:.2} times the bound of translation and rotation", self.name));
        assert!(t <= most && r <= most, "{}: {t} and {r} times the bound", self.name);
    }
}

/// A whole swing of the tilt, and the whole range of its axis.
fn relief() -> SequenceOptions {
    SequenceOptions { frames: 80, ..SequenceOptions::default() }
}

fn textured_box() -> SequenceOptions {
    SequenceOptions { scene: SceneKind::Box, ..SequenceOptions::default() }
}

/// The relief of the second sequence, in constant light.
static UNLIT_MODEL: LazyLock<Model> = LazyLock::new(|| {
    let options = TrainOptions { modes: MODES, ..TrainOptions::default() };
    trained(&sequence(SceneKind::Relief, 2, 2.0), &sixteen(), &options)
});

/// The same without modes.
static RELIEF_MODEL: LazyLock<Model> =
    LazyLock::new(|| trained(&sequence(SceneKind::Relief, 2, 2.0), &sixteen(), &TrainOptions::default()));

/// The box seen at both ends of its turn.
static BOX_MODEL: LazyLock<Model> =
    LazyLock::new(|| trained(&sequence(SceneKind::Box, 1, 2.0), &[0, 119], &TrainOptions::default()));

static UNLIT: LazyLock<Case> = LazyLock::new(|| Case::new("relief", relief(), &RELIEF_MODEL, 1));

static LIT: LazyLock<Case> = LazyLock::new(|| {
    let lit = |sequence| SequenceOptions { light: true, sequence, ..relief() };
    let training = Sequence::new(lit(2)).expect("good options");
    let model = trained(&training, &sixteen(), &TrainOptions { modes: MODES, ..TrainOptions::default() });
    Case::new("relief in changing light", lit(1), &model, 1)
});

static LIT_ANEW: LazyLock<Case> = LazyLock::new(|| {
    let options = SequenceOptions { light: true, ..relief() };
    Case::new("relief in light that the model never saw", options, &UNLIT_MODEL, 1)
});

static COVERED_20: LazyLock<Case> = LazyLock::new(|| {
    Case::new("relief, 20 % covered", SequenceOptions { occlusion: 0.2, ..relief() }, &RELIEF_MODEL, 1)
});

static COVERED_40: LazyLock<Case> = LazyLock::new(|| {
    Case::new("relief, 40 % covered", SequenceOptions { occlusion: 0.4, ..relief() }, &RELIEF_MODEL, 1)
});

static BOX: LazyLock<Case> = LazyLock::new(|| Case::new("box", textured_box(), &BOX_MODEL, 1));

static LIT_BOX: LazyLock<Case> = LazyLock::new(|| {
    let options = SequenceOptions { light: true, ..textured_box() };
    Case::new("box in light that the model never saw", options, &BOX_MODEL, 1)
});

static COVERED_BOX: LazyLock<Case> = LazyLock::new(|| {
    Case::new("box, 30 % covered", SequenceOptions { occlusion: 0.3, ..textured_box() }, &BOX_MODEL, 1)
});

#[test]
fn light_that_changes() {
    LIT.check(0.06);
    LIT.check_bound(6.0);
}

#[test]
fn light_that_the_model_never_saw() {
    LIT_ANEW.check(0.2);
    LIT_ANEW.check_bound(6.0);
}

/// About a tenth of the relief and a quarter of the box are white; of the last one most.
#[test]
fn too_much_light() {
    let bright = |exposure, options| SequenceOptions { exposure, frames: 30, ..options };
    Case::new("overexposed relief", bright(1.7, relief()), &RELIEF_MODEL, 1).check(0.03);
    Case::new("overexposed box", bright(1.7, textured_box()), &BOX_MODEL, 1).check(0.05);
    Case::new("white relief", bright(2.5, relief()), &RELIEF_MODEL, 1).check(0.8);
}

#[test]
fn a_fifth_of_the_object_covered() {
    COVERED_20.check(0.04);
    COVERED_20.check_bound(5.0);
}

#[test]
fn two_fifths_of_the_object_covered() {
    COVERED_40.check(0.08);
    COVERED_40.check_bound(5.0);
}

/// Here a descent without triangle weights on the coarsest level goes astray.
#[test]
fn two_fifths_of_the_object_covered_by_something_strong() {
    let model = trained(&sequence(SceneKind::Relief, 1, 2.0), &sixteen(), &TrainOptions::default());
    let options = SequenceOptions { occlusion: 0.4, sequence: 2, ..relief() };
    Case::new("relief, 40 % covered, second sequence", options, &model, 1).check(0.08);
}

/// Half of the triangles are covered at least in part, and clutter leads the coarse levels astray. With `AAM6D_FIGURES=1` six
/// textures from `AAM6D_SEED` (1) on, whole sequences.
#[test]
fn two_fifths_of_another_texture_covered() {
    let all = std::env::var_os("AAM6D_FIGURES").is_some();
    let first = std::env::var("AAM6D_SEED").ok().and_then(|seed| seed.parse().ok()).unwrap_or(1);
    let cases =
        if all { (first..first + 6).flat_map(|seed| [(seed, 1), (seed, 2)]).collect() } else { vec![(2, 1)] };
    for (seed, number) in cases {
        let options = SequenceOptions { seed, sequence: number, ..SequenceOptions::default() };
        let training = SequenceOptions { sequence: 3 - number, ..options };
        let training = Sequence::new(training).expect("good options");
        let model = trained(&training, &sixteen(), &TrainOptions::default());
        for (light, some) in [(false, 98..110), (true, 10..20)] {
            let options = SequenceOptions { occlusion: 0.4, light, ..options };
            let sequence = Sequence::new(options).expect("good options");
            let day = follow(&sequence, &model, if all { 0..options.frames } else { some });
            let name = if light { "relief, 40 % covered, changing light" } else { "relief, 40 % covered" };
            let case = Case { name, sequence, day };
            say(format_args!("texture {seed}, sequence {number}"));
            case.say();
            if !all {
                case.check(0.08);
            }
        }
    }
}

/// More than half of the triangles are touched by clutter, and in one frame the right pose is not believed. The next ones correlate
/// little as well, but nothing is left open.
#[test]
fn what_is_lost_under_clutter_is_believed_again() {
    let options = SequenceOptions { seed: 5, sequence: 2, ..SequenceOptions::default() };
    let training = Sequence::new(SequenceOptions { sequence: 1, ..options }).expect("good options");
    let model = trained(&training, &sixteen(), &TrainOptions::default());
    let sequence = Sequence::new(SequenceOptions { occlusion: 0.4, ..options }).expect("good options");
    let day = follow(&sequence, &model, 106..118);
    let case = Case { name: "relief, 40 % covered, once lost", sequence, day };
    case.say();
    let lost = case.day.lost();
    assert!(lost <= 1 && case.day.p95_px() < 0.1, "{lost} lost, {} px", case.day.p95_px());
}

#[test]
fn what_guards_against_occluders_costs_nothing_without_one() {
    UNLIT.check(0.03);
    UNLIT.check_bound(2.0);
    let frames = || 0..COST_FRAMES;
    let plain = Options { robust: false, ..Options::default() };
    let without = follow_with(&UNLIT.sequence, &RELIEF_MODEL, frames(), plain).rms();
    let with = follow(&UNLIT.sequence, &RELIEF_MODEL, frames()).rms();
    say(format_args!("with triangle weights {with:?}, without {without:?} (mm, deg)"));
    assert!(with[0] <= 1.05 * without[0] && with[1] <= 1.05 * without[1], "{with:?} against {without:?}");
}

#[test]
fn three_tenths_of_the_box_covered() {
    COVERED_BOX.check(0.3);
    let p95 = COVERED_BOX.day.p95_px();
    assert!(p95 <= 0.8, "{p95} px");
}

/// The model is trained on sharp images.
#[test]
fn a_blurred_and_noisy_box() {
    let options = SequenceOptions { blur: 1.5, noise: 10.0, ..textured_box() };
    let case = Case::new("box, blur 1.5 px, noise 10", options, &BOX_MODEL, 1);
    case.check(0.4);
    let median = case.day.median_mm(&case.sequence);
    assert!(median <= 0.15, "{median} mm");
}

#[test]
fn once_round() {
    let frames = 240;
    let options = SequenceOptions { scene: SceneKind::Turntable, frames, ..SequenceOptions::default() };
    let training = Sequence::new(options).expect("good options");
    let every_45_degrees: Vec<usize> = (0..8).map(|k| k * frames / 8).collect();
    let model = trained(&training, &every_45_degrees, &TrainOptions::default());
    let case = Case::new("box going round", options, &model, 1);
    case.check(0.3);
    assert!(case.day.rms()[1] <= 0.1, "{} deg", case.day.rms()[1]);
}

#[test]
fn dropped_frames() {
    for step in [4, 8] {
        let name = if step == 4 { "every 4th frame" } else { "every 8th frame" };
        for (options, model) in [(SequenceOptions::default(), &*RELIEF_MODEL), (textured_box(), &*BOX_MODEL)]
        {
            let case = Case::new(name, options, model, step);
            let most = if step == 4 { 0 } else { case.day.tracked.len() / 20 };
            assert!(case.day.lost() <= most, "{name}: {} lost", case.day.lost());
        }
    }
}

/// The mean over unlit, lit and covered sequences of both objects. Models of few views alone are above it
/// (`docs/maths.md`, "Covariance").
#[test]
fn the_covariance_tells_the_truth() {
    let cases = [&UNLIT, &LIT, &LIT_ANEW, &COVERED_20, &COVERED_40, &BOX, &LIT_BOX, &COVERED_BOX]
        .map(|c| c.day.consistency());
    #[expect(clippy::cast_precision_loss, reason = "a handful")]
    let mean = cases.iter().sum::<f64>() / cases.len() as f64;
    say(format_args!("normalised error squared: {mean:.2}, mean of {cases:.2?}"));
    assert!((5.0..=7.0).contains(&mean), "{mean}, mean of {cases:?}");
}
