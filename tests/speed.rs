//! Is the fast implementation fast? A ratio within one process and one thread, so that neither the machine nor its
//! load decides: both implementations take turns, and the CPU time of the quickest turn of each counts.

mod support;

use std::time::Duration;

use aam6d::backend::{Backend, CpuBackend, Sums};
use cpu_time::ThreadTime;
use support::Scene;

/// A full template with eight modes.
const PIXELS: usize = 72_000;
const MODES: usize = 8;
/// The goal is 8, in builds with all optimisation (the dev profile reaches 7); half of it is the margin for other processors and for neighbours that take cache and bandwidth.
const MIN_RATIO: f64 = 4.0;
/// Calls in a row per turn, as in an alignment: the first finds the cache full of the other's data.
const CALLS: usize = 8;
/// Turns per attempt.
const TURNS: usize = 4;
/// Neighbours can fill all turns of an attempt, so the test comes back after a pause. The best attempt counts:
/// disturbances make the fast implementation, which lives by the cache, look worse, and none makes slow code pass.
const ATTEMPTS: u32 = 30;
/// Pause before the second attempt; later ones are longer.
const PAUSE: Duration = Duration::from_millis(50);

/// A loaded backend that is ready to go.
struct Runner {
    backend: CpuBackend,
    model: aam6d::backend::ModelId,
    sums: Sums,
}

impl Runner {
    fn new(mut backend: CpuBackend, scene: &Scene) -> Self {
        let model = backend.load(&scene.model).expect("the CPU takes every model");
        backend.set_frame(&scene.image, 1).expect("the CPU takes every frame");
        Self { backend, model, sums: Sums::default() }
    }

    /// CPU time of the quickest of a few calls, ns per pixel.
    fn turn(&mut self, scene: &Scene) -> f64 {
        (0..CALLS).map(|_| self.call(scene)).fold(f64::INFINITY, f64::min)
    }

    fn call(&mut self, scene: &Scene) -> f64 {
        let began = ThreadTime::now();
        self.backend.accumulate(&scene.request(self.model), &mut self.sums).expect("the scene fits");
        began.elapsed().as_secs_f64() * 1e9 / PIXELS as f64
    }
}

fn attempt(scene: &Scene) -> [f64; 2] {
    let mut runners = [CpuBackend::twin(), CpuBackend::new()].map(|backend| Runner::new(backend, scene));
    let mut best = [f64::INFINITY; 2];
    for _ in 0..TURNS {
        for (best, runner) in best.iter_mut().zip(&mut runners) {
            *best = best.min(runner.turn(scene));
        }
    }
    best
}

#[test]
fn fast_is_fast() {
    let scene = Scene::new(1, PIXELS, MODES, 1);
    // One thread, so that its CPU time is all there is.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    let mut seen = Vec::new();
    for k in 0..ATTEMPTS {
        std::thread::sleep(PAUSE * k);
        let [twin, fast] = pool.install(|| attempt(&scene));
        if twin / fast >= MIN_RATIO {
            return;
        }
        seen.push(twin / fast);
    }
    panic!("the fast implementation is {seen:.1?} times as fast as the twin, at least {MIN_RATIO} is needed");
}
