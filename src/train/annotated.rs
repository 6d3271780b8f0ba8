//! Annotated training (section 2 of the paper): images whose landmarks are marked, and no poses.
//!
//! The pose of every image follows from its landmarks; then poses and landmarks are refined together. The mesh is the
//! Delaunay triangulation of the landmarks in the image that sees the shape most frontally. Training goes on as with
//! posed images.

use image::GrayImage;
use nalgebra::{Matrix3, Point2, Point3, Vector3};

use super::TrainingImage;
use crate::dataset::Landmark;
use crate::error::{Error, Result};
use crate::geometry::bundle::{self, Mark, Prior, Sighting};
use crate::geometry::mesh::delaunay;
use crate::geometry::pnp::{self, PnpSolution};
use crate::geometry::{Camera, Pose, TriangleMesh};

/// Triangles of the mesh that are smaller than this in the reference image are slivers of the outline, square pixels.
const MIN_TRIANGLE_PX2: f64 = 40.0;

/// A training image with all landmarks marked.
#[derive(Debug, Clone)]
pub struct AnnotatedImage {
    /// Frame id, for messages.
    pub frame: u32,
    /// Rectified image.
    pub image: GrayImage,
    /// The camera as calibrated, with its lens: the annotations are in the image as taken.
    pub camera: Camera,
    /// One pixel per landmark.
    pub landmarks: Vec<Point2<f64>>,
}

impl AnnotatedImage {
    /// The annotations as marks in the rectified image; those that the lens model does not cover count as not seen.
    pub fn rectified_marks(&self, sigma_px: f64) -> Vec<Mark> {
        let (pinhole, unseen) = (self.camera.rectified(), Mark::unseen());
        let rectify = |pixel| pinhole.project(&self.camera.ray(pixel)?.into());
        self.landmarks.iter().map(|p| rectify(p).map_or(unseen, |p| Mark::new(p, sigma_px))).collect()
    }
}

/// What annotations are believed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AnnotationOptions {
    /// An annotation further than this from its reprojected landmark is refused, pixels.
    pub max_distance_px: f64,
    /// Standard deviation of an annotation, pixels per coordinate: how it weighs against the landmarks' covariance.
    pub sigma_px: f64,
    /// Refine the landmarks with the poses; those without covariance stay.
    pub refine: bool,
}

impl Default for AnnotationOptions {
    fn default() -> Self {
        Self { max_distance_px: 10.0, sigma_px: 0.3, refine: true }
    }
}

/// What the annotations changed in the landmarks. Root mean squares over landmarks and axes, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Refinement {
    /// How far the landmarks moved.
    pub moved: f64,
    /// Their standard deviation before.
    pub sigma_before: f64,
    /// And after.
    pub sigma_after: f64,
}

impl Refinement {
    /// From what was known to what is.
    pub fn between(before: &[Prior], after: &[Prior]) -> Self {
        #[expect(clippy::cast_precision_loss, reason = "landmark counts are far below 2^52")]
        let rms = |squares: f64| (squares / (3 * before.len()) as f64).sqrt();
        let spread = |points: &[Prior]| points.iter().map(|p| p.covariance.trace()).sum();
        let moved = before.iter().zip(after).map(|(a, b)| (a.position - b.position).norm_squared()).sum();
        Self { moved: rms(moved), sigma_before: rms(spread(before)), sigma_after: rms(spread(after)) }
    }
}

/// Annotated images made ready for [`super::train`].
#[derive(Debug, Clone)]
pub struct Posed {
    /// The images with their poses.
    pub images: Vec<TrainingImage>,
    /// How well the landmarks fit, per image.
    pub fits: Vec<PnpSolution>,
    /// What became of the landmarks, if they were refined.
    pub refinement: Option<Refinement>,
    /// The landmarks' mesh.
    pub mesh: TriangleMesh,
    /// Index of the image in which the landmarks were triangulated.
    pub reference: usize,
}

/// Finds the poses of annotated images by their landmarks (object frame), refines both, and joins the landmarks to a
/// mesh.
///
/// # Errors
/// [`Error::Invalid`] naming the frame for what [`pnp::solve`] refuses, and frame and landmark of an annotation that
/// does not fit; what [`bundle::refine`] refuses; [`Error::Invalid`] if the landmarks span no surface.
pub fn pose(
    landmarks: &[Landmark],
    images: Vec<AnnotatedImage>,
    options: &AnnotationOptions,
) -> Result<Posed> {
    let mut shape: Vec<Point3<f64>> = landmarks.iter().map(|l| l.position).collect();
    let fits: Result<Vec<PnpSolution>> =
        images.iter().map(|image| fit(&shape, image, options.max_distance_px)).collect();
    let mut fits = fits?;
    let known = landmarks.iter().all(|l| l.covariance == Matrix3::zeros());
    let refinement = if options.refine && !known && !images.is_empty() {
        Some(refine(landmarks, &images, options.sigma_px, &mut shape, &mut fits)?)
    } else {
        None
    };
    let views: Vec<Pose> = fits.iter().map(|f| f.camera_from_object).collect();
    let Some(reference) = most_frontal(&shape, &views) else {
        return Err(Error::invalid("training", "there is no annotated image", "annotate at least one"));
    };
    let mesh = landmark_mesh(&shape, &images[reference].camera.rectified(), &views[reference])?;
    let posed = |(image, camera_from_object): (AnnotatedImage, Pose)| TrainingImage {
        image: image.image,
        camera: image.camera.rectified(),
        camera_from_object,
    };
    let images = images.into_iter().zip(views).map(posed).collect();
    Ok(Posed { images, fits, refinement, mesh, reference })
}

/// Bundle adjustment of `shape` and the poses of `fits`.
fn refine(
    landmarks: &[Landmark],
    images: &[AnnotatedImage],
    sigma_px: f64,
    shape: &mut [Point3<f64>],
    fits: &mut [PnpSolution],
) -> Result<Refinement> {
    let priors = priors(landmarks);
    let sighting = |(image, fit): (&AnnotatedImage, &PnpSolution)| Sighting {
        camera: image.camera,
        camera_from_object: fit.camera_from_object,
        marks: image.landmarks.iter().map(|p| Mark::new(*p, sigma_px)).collect(),
    };
    let sightings: Vec<Sighting> = images.iter().zip(fits.iter()).map(sighting).collect();
    let bundle = bundle::refine(&priors, &sightings)?;
    for (x, point) in shape.iter_mut().zip(&bundle.points) {
        *x = point.position;
    }
    for ((fit, pose), image) in fits.iter_mut().zip(&bundle.poses).zip(images) {
        *fit = PnpSolution::of(*pose, &image.camera, shape, &image.landmarks);
    }
    Ok(Refinement::between(&priors, &bundle.points))
}

/// The landmarks as a bundle adjustment takes them.
pub fn priors(landmarks: &[Landmark]) -> Vec<Prior> {
    landmarks.iter().map(|l| Prior { position: l.position, covariance: l.covariance }).collect()
}

fn fit(shape: &[Point3<f64>], annotated: &AnnotatedImage, max_distance_px: f64) -> Result<PnpSolution> {
    let frame = |e| match e {
        Error::Invalid { what, problem, remedy } => {
            Error::invalid(format!("frame {}: {what}", annotated.frame), problem, remedy)
        }
        other => other,
    };
    let fit = pnp::solve(&annotated.camera, shape, &annotated.landmarks).map_err(frame)?;
    let far = |&k: &usize| {
        // Written so that NaN is far too.
        let near = fit.distances_px[k] <= max_distance_px;
        !near
    };
    let worst = (0..shape.len()).max_by(|&a, &b| fit.distances_px[a].total_cmp(&fit.distances_px[b]));
    if let Some(k) = worst.filter(far) {
        let problem = format!(
            "landmark {k} is annotated {:.1} px from where it should be (rms of all {:.2} px)",
            fit.distances_px[k], fit.rms_px
        );
        let remedy = "annotate it again, and check that landmarks and annotations have the same names";
        return Err(Error::invalid(format!("frame {}", annotated.frame), problem, remedy));
    }
    Ok(fit)
}

/// The view whose line of sight is nearest to the normal of the points' best plane.
fn most_frontal(shape: &[Point3<f64>], views: &[Pose]) -> Option<usize> {
    #[expect(clippy::cast_precision_loss, reason = "point counts are far below 2^52")]
    let centre = Point3::from(shape.iter().fold(Vector3::zeros(), |s, p| s + p.coords) / shape.len() as f64);
    let scatter = shape.iter().fold(Matrix3::zeros(), |m, p| m + (p - centre) * (p - centre).transpose());
    let eigen = scatter.symmetric_eigen();
    let normal: Vector3<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into();
    let cosine = |pose: &Pose| {
        let sight = pose.transform_point(&centre).coords;
        pose.rotate(&normal).dot(&sight.normalize()).abs()
    };
    (0..views.len()).max_by(|&a, &b| cosine(&views[a]).total_cmp(&cosine(&views[b])))
}

/// Joins landmarks to a mesh by Delaunay triangulation of their pixels in a view; outside is where the camera is.
///
/// # Errors
/// [`Error::Invalid`] if a landmark is behind the camera, two coincide in the image, or all are on one line.
pub fn landmark_mesh(
    shape: &[Point3<f64>],
    camera: &Camera,
    camera_from_object: &Pose,
) -> Result<TriangleMesh> {
    let project = |(k, x): (usize, &Point3<f64>)| {
        camera.project(&camera_from_object.transform_point(x)).ok_or_else(|| {
            let problem = "it is behind the camera";
            Error::invalid(format!("landmark {k}"), problem, "check landmarks and annotations")
        })
    };
    let pixels: Result<Vec<Point2<f64>>> = shape.iter().enumerate().map(project).collect();
    let triangles = delaunay(&pixels?, MIN_TRIANGLE_PX2)?;
    // Clockwise on screen, y down, is a normal along the view: turned round, it looks at the camera.
    let triangles = triangles.into_iter().map(|[a, b, c]| [a, c, b]).collect();
    Ok(TriangleMesh { vertices: shape.to_vec(), triangles })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::{Renderer, View, relief};
    use crate::train::{TrainOptions, train};
    use nalgebra::Rotation3;

    const OPTIONS: AnnotationOptions =
        AnnotationOptions { max_distance_px: 5.0, sigma_px: 0.3, refine: true };

    /// The relief's landmarks, exact.
    fn shape() -> Vec<Landmark> {
        let landmark = |&position| Landmark { name: String::new(), position, covariance: Matrix3::zeros() };
        relief(1).mesh.vertices.iter().map(landmark).collect()
    }

    fn annotated(frame: u32, turn: [f64; 3]) -> (Pose, AnnotatedImage) {
        let camera = Camera::pinhole(400.0, 400.0, 159.5, 119.5, 320, 240);
        let pose = Pose::new(Rotation3::new(turn.into()), Vector3::new(0.01, 0.0, 0.6));
        let object = relief(1);
        let see = |x: &Point3<f64>| camera.project(&pose.transform_point(x)).unwrap();
        let landmarks = object.mesh.vertices.iter().map(see).collect();
        let image = Renderer::new(object, camera).unwrap().render_view(&View { pose, ..View::default() });
        (pose, AnnotatedImage { frame, image, camera, landmarks })
    }

    #[test]
    fn exact_annotations_give_poses_mesh_and_model() {
        let (tilted, frontal) = (annotated(4, [0.4, 0.2, 0.3]), annotated(9, [0.02, 0.0, 0.0]));
        let posed = pose(&shape(), vec![tilted.1, frontal.1], &OPTIONS).unwrap();
        assert_eq!(posed.reference, 1, "the frontal view");
        for (image, truth) in posed.images.iter().zip([tilted.0, frontal.0]) {
            let off = (image.camera_from_object.matrix() - truth.matrix()).norm();
            assert!(off < 1e-6, "{off}");
        }
        assert!((posed.mesh.area() / relief(1).mesh.area() - 1.0).abs() < 0.01, "{}", posed.mesh.area());
        assert!((0..posed.mesh.triangles.len()).all(|t| posed.mesh.normal(t).z < 0.0), "the front looks out");
        let model = train(&posed.mesh, &posed.images, &TrainOptions::default()).unwrap();
        assert!(model.levels[0].pixels.len() > 10_000, "{} px", model.levels[0].pixels.len());
    }

    /// Depths that are 2 mm off are put right by two oblique views.
    #[test]
    fn landmarks_are_refined_unless_exact() {
        let images = || [[0.4, 0.2, 0.3], [-0.4, 0.1, 0.0]].map(|turn| annotated(4, turn).1).to_vec();
        assert!(pose(&shape(), images(), &OPTIONS).unwrap().refinement.is_none(), "exact landmarks stay");
        let mut wrong = shape();
        for (k, landmark) in wrong.iter_mut().enumerate() {
            landmark.position.z += if k % 2 == 0 { 0.002 } else { -0.002 };
            landmark.covariance = Matrix3::from_diagonal(&Vector3::new(1e-8, 1e-8, 4e-6));
        }
        let off = |options| {
            let vertices = pose(&wrong, images(), &options).unwrap().mesh.vertices;
            let squares = vertices.iter().zip(shape()).map(|(a, b)| (a - b.position).norm_squared());
            (squares.sum::<f64>() / 76.0).sqrt()
        };
        let (before, after) = (off(AnnotationOptions { refine: false, ..OPTIONS }), off(OPTIONS));
        assert!((before - 0.002).abs() < 1e-12 && after < 0.0005, "{before} to {after} m");
        let refinement = pose(&wrong, images(), &OPTIONS).unwrap().refinement.unwrap();
        assert!(refinement.sigma_after < 0.5 * refinement.sigma_before, "{refinement:?}");
        assert!((refinement.moved - 0.002 / 3_f64.sqrt()).abs() < 3e-4, "{refinement:?}");
    }

    #[test]
    fn wrong_annotations_are_named() {
        let shape = shape();
        let mut wrong = annotated(4, [0.4, 0.2, 0.3]).1;
        wrong.landmarks[30].x += 25.0;
        let text = pose(&shape, vec![wrong.clone()], &OPTIONS).unwrap_err().to_string();
        assert!(text.contains("frame 4: landmark 30"), "{text}");
        let text = pose(&shape[..5], vec![wrong.clone()], &OPTIONS).unwrap_err().to_string();
        assert!(text.contains("frame 4") && text.contains("5 points, but 76"), "{text}");
        wrong.landmarks.truncate(3);
        let text = pose(&shape[..3], vec![wrong], &OPTIONS).unwrap_err().to_string();
        assert!(text.contains("frame 4") && text.contains("too few"), "{text}");
        assert!(pose(&shape, Vec::new(), &OPTIONS).is_err(), "no image");
    }
}
