//! Many streams of one object, or many objects in one frame: every track has a state of its own, and all share what is
//! loaded and the cores.

use std::sync::Arc;
use std::time::Instant;

use image::GrayImage;
use rayon::prelude::*;

use super::course::Course;
use super::search::Search;
use super::{FrameTimes, Tracked, Tracker, ms_since};
use crate::align::{PoseEstimate, Start, Target};
use crate::error::{Error, Result};

impl Tracker {
    /// A tracker of the same object for another stream of the same camera, without a pose to start from. It shares the
    /// model with this one, on the host and on the device.
    ///
    /// # Errors
    /// Those of [`crate::backend::Backend::another`].
    pub fn another(&self) -> Result<Self> {
        Ok(Self {
            backend: self.backend.another()?,
            aligner: self.aligner.another(),
            model: self.model.clone(),
            id: self.id,
            camera: self.camera,
            rectifier: self.rectifier.clone(),
            rectified: GrayImage::default(),
            is_rectified: false,
            times: FrameTimes::default(),
            course: Course::unknown(self.model.modes()),
            search: self.search.as_ref().map(Search::another),
            starts: Vec::new(),
            estimates: Vec::new(),
        })
    }

    /// Tracks every object into its next frame: `images[k]` is that of `trackers[k]`. Trackers of different objects may be
    /// given the same image. Each result is what [`Self::track`] would have given, whatever the others do, and one
    /// that fails leaves the others alone.
    ///
    /// Where the backend can, trackers of one origin ([`Self::another`]) share calls: one per step serves all of them. Their
    /// [`Tracked::times`] are then those of all together, but for the rectification.
    ///
    /// # Errors
    /// [`Error::Invalid`] if there are not as many images as trackers, and errors of the backend in shared calls; each
    /// result has the errors of [`Self::track`].
    pub fn track_batch(trackers: &mut [Self], images: &[&GrayImage]) -> Result<Vec<Result<Tracked>>> {
        if trackers.len() != images.len() {
            let problem = format!("{} images for {} trackers", images.len(), trackers.len());
            return Err(Error::invalid("batch", problem, "give one image per tracker"));
        }
        let pairs = trackers.iter_mut().zip(images.iter().copied());
        let mut streams: Vec<Stream<'_>> =
            pairs.map(|(tracker, image)| Stream { tracker, image, tracked: None }).collect();
        for mut kin in kin(&mut streams) {
            let size = kin[0].image.dimensions();
            let at_once = kin[0].tracker.backend.frames_at_once(size);
            kin.chunks_mut(at_once.max(1)).try_for_each(track_together)?;
        }
        let result = |stream: Stream<'_>| match stream.tracked {
            Some(tracked) => Ok(tracked),
            None => stream.tracker.track(stream.image),
        };
        Ok(streams.into_par_iter().map(result).collect())
    }
}

/// A tracker with its next frame.
struct Stream<'a> {
    tracker: &'a mut Tracker,
    image: &'a GrayImage,
    /// What came of shared calls, if that is all there is to it.
    tracked: Option<Tracked>,
}

impl Stream<'_> {
    /// Can the frame be aligned together with those of other streams?
    fn can_share(&self) -> bool {
        let Tracker { backend, aligner, course, .. } = &*self.tracker;
        let is_ready = course.motion.is_some() && self.tracker.fits(self.image);
        is_ready && aligner.shares_calls() && backend.frames_at_once(self.image.dimensions()) > 1
    }

    /// Rectifies the frame and says where the object is expected in it.
    fn start(&mut self) -> Start {
        self.tracker.rectify(self.image);
        let Tracker { course, model, .. } = &*self.tracker;
        let mut start = Start::default();
        if let Some(motion) = &course.motion {
            course.expected(motion, model, &mut start);
        }
        start
    }

    /// Takes up what came of the shared calls; where more is to be done, such as a search, the stream is left to be tracked
    /// alone.
    fn take(&mut self, estimate: PoseEstimate, times: FrameTimes, began: Instant) {
        let tracker = &mut *self.tracker;
        if estimate.score.is_lost() || !estimate.converged || tracker.is_doubtful(&estimate) {
            return;
        }
        tracker.times = FrameTimes { rectify_ms: tracker.times.rectify_ms, ..times };
        let status = tracker.course.status(&estimate, &tracker.model, &tracker.camera);
        let tracked = self.tracked.insert(Tracked { status, estimate, ..Tracked::default() });
        tracker.conclude(began, tracked);
    }
}

/// Streams that can share calls: of one model, loaded once, with frames of one size.
fn kin<'s, 'a>(streams: &'s mut [Stream<'a>]) -> Vec<Vec<&'s mut Stream<'a>>> {
    let mut kin: Vec<Vec<&mut Stream<'_>>> = Vec::new();
    for stream in streams.iter_mut().filter(|stream| stream.can_share()) {
        let is_alike = |other: &Stream<'_>| {
            Arc::ptr_eq(&other.tracker.model, &stream.tracker.model)
                && other.image.dimensions() == stream.image.dimensions()
        };
        match kin.iter_mut().find(|group| is_alike(&*group[0])) {
            Some(group) => group.push(stream),
            None => kin.push(vec![stream]),
        }
    }
    kin
}

/// Aligns the frames of kin with the backend of the first of them.
fn track_together(streams: &mut [&mut Stream<'_>]) -> Result<()> {
    let began = Instant::now();
    let starts: Vec<Start> = streams.par_iter_mut().map(|stream| stream.start()).collect();
    let Some((first, others)) = streams.split_first_mut().filter(|(_, others)| !others.is_empty()) else {
        return Ok(());
    };
    let (mut times, mut estimates) = (FrameTimes::default(), Vec::new());
    {
        let Tracker { backend, aligner, model, id, camera, rectified, is_rectified, .. } =
            &mut *first.tracker;
        let image = if *is_rectified { &*rectified } else { first.image };
        let target = Target { model, id: *id, camera: camera.rectified(), image };
        let others = others.iter().map(|stream| stream.tracker.target(stream.image));
        let targets: Vec<Target<'_>> = std::iter::once(target).chain(others).collect();
        let images: Vec<&GrayImage> = targets.iter().map(|target| target.image).collect();
        let upload = Instant::now();
        backend.set_frames(&images, aligner.levels(model))?;
        times.set_frame_ms = ms_since(upload);
        aligner.align_streams(backend.as_mut(), &targets, &starts, &mut estimates)?;
        times.align = aligner.times();
    }
    for (stream, estimate) in streams.iter_mut().zip(estimates) {
        stream.take(estimate, times, began);
    }
    Ok(())
}
