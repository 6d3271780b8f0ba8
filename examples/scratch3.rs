#![allow(warnings)]
use aam6d::{geometry::*, simulate::*, *};
use nalgebra::*;
fn main() {
    for (scene, noise, seqn) in [
        (SceneKind::Relief, 2.0, 1),
        (SceneKind::Relief, 2.0, 2),
        (SceneKind::Box, 2.0, 1),
        (SceneKind::Box, 10.0, 1),
    ] {
        let s = Sequence::new(SequenceOptions { scene, sequence: seqn, ..Default::default() }).unwrap();
        let v = &s.object().mesh.vertices;
        let c = Point3::from(v.iter().fold(Vector3::zeros(), |a, x| a + x.coords) / v.len() as f64);
        let mut t2 = 0.0;
        let mut r2 = 0.0;
        let mut n = 0.0;
        let mut ax = Vector6::zeros();
        for k in (0..120).step_by(12) {
            let p = s.pose(k);
            let cov = s.renderer().coverage(&p);
            let mut cols = vec![];
            let h = [2.8e-4, 2.8e-4, 2e-3, 0.02, 0.02, 0.004];
            for i in 0..6 {
                let mut d = Vector6::zeros();
                d[i] = h[i];
                let a = s.renderer().render(&p.compose(&Pose::increment(&d, &c)));
                let b = s.renderer().render(&p.compose(&Pose::increment(&-d, &c)));
                cols.push((a, b, h[i]));
            }
            let mut m = Matrix6::zeros();
            for q in 0..cov.len() {
                if cov[q] < 0.999 {
                    continue;
                }
                let j = Vector6::from_fn(|i, _| {
                    (f64::from(cols[i].0.as_raw()[q]) - f64::from(cols[i].1.as_raw()[q])) / (2.0 * cols[i].2)
                });
                m += j * j.transpose();
            }
            let crb = m.try_inverse().unwrap() * (noise * noise + 1.0 / 12.0);
            t2 += (crb[(0, 0)] + crb[(1, 1)] + crb[(2, 2)]) * 1e6;
            r2 += (crb[(3, 3)] + crb[(4, 4)] + crb[(5, 5)]) * (180.0f64 / std::f64::consts::PI).powi(2);
            n += 1.0;
            ax += crb.diagonal();
        }
        println!(
            "{scene:?} noise {noise} seq {seqn}: CRB rms t {:.5} mm r {:.5} deg",
            (t2 / n as f64).sqrt(),
            (r2 / n as f64).sqrt()
        );
    }
}
