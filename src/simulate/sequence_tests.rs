use super::*;

fn sequence(change: impl FnOnce(&mut SequenceOptions)) -> Sequence {
    let mut options = SequenceOptions { frames: 4, ..SequenceOptions::default() };
    change(&mut options);
    Sequence::new(options).expect("good options")
}

#[test]
fn a_sequence_repeats_itself_and_differs_from_the_other() {
    let first = sequence(|_| ());
    assert_eq!(first.image(3), sequence(|o| o.frames = 50).image(3), "frame 3 of a longer sequence");
    let second = sequence(|o| o.sequence = 2);
    assert_ne!(first.pose(3), second.pose(3), "motion");
    assert_ne!(first.image(3), second.image(3), "image");
    assert_eq!(first.object(), second.object(), "the object is the same");
    let frames: Vec<_> = first.frames().collect();
    assert_eq!(frames.len(), 4, "length");
    assert_eq!(frames[2], (first.pose(2), first.image(2)), "the iterator gives the same frames");
}

#[test]
fn objects_stay_in_the_image_and_move_a_few_pixels() {
    for (scene, number) in
        [(SceneKind::Relief, 1), (SceneKind::Relief, 2), (SceneKind::Box, 1), (SceneKind::Box, 2)]
    {
        let sequence = sequence(|o| (o.scene, o.sequence) = (scene, number));
        let camera = sequence.camera();
        let pixels = |k: usize| {
            let see = |v| camera.project(&sequence.pose(k).transform_point(v)).expect("in front");
            sequence.object().mesh.vertices.iter().map(see).collect::<Vec<_>>()
        };
        for k in 0..120 {
            let (now, next) = (pixels(k), pixels(k + 1));
            assert!(
                now.iter().all(|p| camera.contains(p, 5.0)),
                "{scene:?} {number}: frame {k} leaves the image"
            );
            let squares: f64 = now.iter().zip(&next).map(|(a, b)| (a - b).norm_squared()).sum();
            let rms = (squares / now.len() as f64).sqrt();
            assert!(rms < 5.0, "{scene:?} {number}: frame {k} moves by {rms} px");
        }
    }
}

#[test]
fn box_shows_three_faces_throughout() {
    let sequence = sequence(|o| o.scene = SceneKind::Box);
    let mesh = &sequence.object().mesh;
    for k in 0..120 {
        let pose = sequence.pose(k);
        let seen = (0..12)
            .filter(|&t| {
                let at = pose.transform_point(&mesh.corners(t)[0]).coords;
                pose.rotate(&mesh.normal(t).normalize()).dot(&at.normalize()) < -0.1
            })
            .count();
        assert_eq!(seen, 6, "frame {k} shows {seen} triangles");
    }
}

#[test]
fn light_changes_the_image_without_saturation() {
    for scene in [SceneKind::Relief, SceneKind::Box] {
        let lit = sequence(|o| (o.scene, o.light) = (scene, true));
        for k in [0, 30, 60, 90] {
            let image = lit.image(k);
            let (lo, hi) = image.iter().fold((255, 0), |(lo, hi), &v| (v.min(lo), v.max(hi)));
            assert!(lo > 0 && hi < 255, "{scene:?}, frame {k}: {lo}..{hi}");
        }
        assert_ne!(lit.image(0), sequence(|o| o.scene = scene).image(0), "light must be visible");
    }
}

#[test]
fn wrong_options_are_named() {
    let refused = |change: fn(&mut SequenceOptions)| {
        let mut options = SequenceOptions::default();
        change(&mut options);
        Sequence::new(options).expect_err("refused").to_string()
    };
    assert!(refused(|o| o.frames = 0).starts_with("frames: 0 is out of range; give 1 to"), "frames");
    assert!(refused(|o| o.sequence = 3).starts_with("sequence: 3"), "sequence");
    assert!(refused(|o| o.occlusion = f64::NAN).starts_with("occlusion: NaN"), "occlusion");
    assert!(refused(|o| o.noise = -1.0).starts_with("noise: -1"), "noise");
    assert!(refused(|o| o.supersampling = 9).starts_with("supersampling: 9"), "supersampling");
}
