#![allow(warnings)]
use aam6d::{align::*, backend::*, dataset::*, geometry::*, model::*, track::*, train::*, *};
use nalgebra::*;
use rand::{Rng, RngExt, SeedableRng};
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let model = Model::load(std::path::Path::new(&a[1])).unwrap();
    let ds = Dataset::open(&a[2]).unwrap();
    let sc = ds.scene(a[3].parse().unwrap()).unwrap();
    let truth = ds.poses(sc.id, 1, &PoseSource::GroundTruth).unwrap();
    let step: usize = a[4].parse().unwrap();
    let trials: usize = a[5].parse().unwrap();
    let mut tk = Tracker::new(
        model,
        sc.frames[0].camera,
        Box::new(CpuBackend::new()),
        Box::new(InverseCompositional::default()),
    )
    .unwrap();
    let corners = tk.model().shape.corners;
    let ctr = Point3::from((corners[0].coords + corners[7].coords) / 2.0);
    let cam = sc.frames[0].camera;
    for (mm, deg) in [(5.0, 1.0), (10.0, 2.0), (20.0, 5.0), (40.0, 10.0)] {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut unit = || loop {
            let v = Vector3::new(
                rng.random_range(-1.0..1.0f64),
                rng.random_range(-1.0..1.0),
                rng.random_range(-1.0..1.0),
            );
            if v.norm() < 1.0 && v.norm() > 0.1 {
                break v.normalize();
            }
        };
        let (mut n, mut ok, mut said, mut wrong, mut far) = (0, 0, 0, 0, 0);
        let t0 = std::time::Instant::now();
        let mut it = 0;
        for f in sc.frames.iter().step_by(step) {
            let img = imaging::gray::read(&f.image).unwrap();
            let t = truth[&f.id];
            for _ in 0..trials {
                let d = Pose::about(unit() * (deg as f64).to_radians(), unit() * mm / 1000.0, &ctr);
                let start = t.compose(&d);
                tk.start_at(start);
                let r = tk.track(&img).unwrap();
                let e = r.estimate.camera_from_object;
                let px = (corners
                    .iter()
                    .map(|x| {
                        cam.project(&e.transform_point(x))
                            .map_or(1e6, |p| (p - cam.project(&t.transform_point(x)).unwrap()).norm_squared())
                    })
                    .sum::<f64>()
                    / 8.0)
                    .sqrt();
                n += 1;
                it += r.estimate.iterations;
                if px < 1.0 {
                    ok += 1;
                }
                if r.status == Status::Tracking {
                    said += 1;
                    if px > 2.5 {
                        wrong += 1;
                    }
                    if px > 10.0 {
                        far += 1;
                    }
                }
            }
        }
        println!(
            "{mm} mm {deg} deg: {ok}/{n} = {:.2} within 1 px; said tracking {said}, of those wrong(>2.5px) {wrong} (>10px) {far}; {:.1} ms each, it {:.1}",
            ok as f64 / n as f64,
            t0.elapsed().as_secs_f64() * 1e3 / n as f64,
            it as f64 / n as f64
        );
    }
}
