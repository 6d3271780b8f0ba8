//! Data sets in the BOP layout: scenes with images and cameras, object meshes, known poses.
//!
//! ```text
//! <root>/camera.json                      width, height (optional)
//! <root>/models/obj_000001.ply            mesh, millimetres
//! <root>/test/000001/gray/000000.png ...  or rgb/; the split may also be test_*, val*, train* or absent
//! <root>/test/000001/scene_camera.json    cam_K row-major, optional cam_dist [k1, k2, p1, p2, k3]
//! <root>/test/000001/scene_gt.json        poses, millimetres; scene_ref.json alike
//! ```

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::calibration::{camera_from_matrix, distortion};
use super::json::{Document, Node};
use super::ply;
use super::poses::{self, PoseSource};
use crate::error::{Error, Result};
use crate::geometry::{Camera, Pose, TriangleMesh};
use crate::imaging::gray;

/// File extensions of images, in the order of preference.
const IMAGE_EXTENSIONS: [&str; 7] = ["png", "tif", "tiff", "pgm", "bmp", "jpg", "jpeg"];

/// Folders of images in a scene, in the order of preference.
const IMAGE_FOLDERS: [&str; 2] = ["gray", "rgb"];

/// Folders of meshes, in the order of preference (T-LESS has no plain `models`).
const MODEL_FOLDERS: [&str; 3] = ["models", "models_cad", "models_eval"];

/// A data set on disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dataset {
    root: PathBuf,
    scenes: BTreeMap<u32, PathBuf>,
}

/// The frames of one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Scene id.
    pub id: u32,
    /// The scene's folder.
    pub folder: PathBuf,
    /// Frames by ascending id.
    pub frames: Vec<FrameInfo>,
}

/// One image and the camera that took it.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameInfo {
    /// Image id.
    pub id: u32,
    /// The calibrated camera, with the image's size.
    pub camera: Camera,
    /// The image file.
    pub image: PathBuf,
}

impl Scene {
    /// The camera of every frame.
    pub fn cameras(&self) -> BTreeMap<u32, Camera> {
        self.frames.iter().map(|f| (f.id, f.camera)).collect()
    }
}

impl Dataset {
    /// Finds the scenes below `path`: in `test*`, `val*` or `train*`, the first that has any, or in `path` itself.
    ///
    /// # Errors
    /// [`Error::Io`] if a folder cannot be read, [`Error::Invalid`] if it holds no scene.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let root = path.as_ref();
        let mut splits: Vec<(usize, String)> = Vec::new();
        for name in folder_names(root)? {
            let rank = ["test", "val", "train"].iter().position(|prefix| name.starts_with(prefix));
            splits.extend(rank.map(|rank| (rank, name)));
        }
        splits.sort();
        let places = splits.iter().map(|(_, name)| root.join(name)).chain([root.to_owned()]);
        for place in places {
            let scenes = scenes_in(&place)?;
            if !scenes.is_empty() {
                return Ok(Self { root: root.to_owned(), scenes });
            }
        }
        let problem = "no scene folder (e.g. test/000001 with scene_camera.json) in it";
        Err(Error::invalid(root.display().to_string(), problem, "give the root of a data set in BOP layout"))
    }

    /// The folder that was opened.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Ids of the scenes, ascending.
    pub fn scene_ids(&self) -> Vec<u32> {
        self.scenes.keys().copied().collect()
    }

    /// The frames of a scene. Only the first image's size is looked at here.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an unknown scene; [`Error::Io`], [`Error::Line`], [`Error::Field`] for files that
    /// are missing or wrong, images without calibration, and an image size other than that of `camera.json`.
    pub fn scene(&self, id: u32) -> Result<Scene> {
        let folder = self.scene_folder(id)?;
        let path = folder.join("scene_camera.json");
        let document = Document::read(&path)?;
        let mut images = images_in(folder)?;
        let Some(first) = images.values().next() else {
            let problem = "no images (png, tif, pgm, bmp, jpg named by number) in gray/ or rgb/";
            return Err(Error::invalid(folder.display().to_string(), problem, "complete the data set"));
        };
        let size = self.image_size(first)?;
        let mut frames = Vec::new();
        for (id, node) in document.root().by_id()? {
            let image = images.remove(&id).ok_or_else(|| {
                node.error(
                    "there is no such image in gray/ or rgb/",
                    "complete the images or remove the entry",
                )
            })?;
            frames.push(FrameInfo { id, camera: camera(&node, size)?, image });
        }
        if let Some(id) = images.keys().next() {
            let problem = format!("no entry for image {id}");
            return Err(document.root().error(problem, "add the camera of every image"));
        }
        frames.sort_by_key(|f| f.id);
        Ok(Scene { id, folder: folder.to_owned(), frames })
    }

    /// Ids of the objects that have a mesh, ascending.
    ///
    /// # Errors
    /// As [`Self::mesh`] if there is no folder of meshes.
    pub fn object_ids(&self) -> Result<Vec<u32>> {
        let folder = self.model_folder()?;
        let names = entry_names(&folder, |t| !t.is_dir())?;
        let id = |name: &String| name.strip_prefix("obj_")?.strip_suffix(".ply")?.parse().ok();
        let mut ids: Vec<u32> = names.iter().filter_map(id).collect();
        ids.sort_unstable();
        Ok(ids)
    }

    /// The mesh of an object, in metres.
    ///
    /// # Errors
    /// [`Error::Invalid`] if there is no folder of meshes, otherwise as [`ply::read`].
    pub fn mesh(&self, object_id: u32) -> Result<TriangleMesh> {
        ply::read(&self.model_folder()?.join(format!("obj_{object_id:06}.ply")))
    }

    /// `models_info.json` beside the meshes, if there is one.
    pub fn models_info(&self) -> Option<PathBuf> {
        self.model_folder().ok().map(|folder| folder.join("models_info.json")).filter(|path| path.is_file())
    }

    /// Poses (`camera_from_object`, metres) of an object in a scene, by frame id.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an unknown scene, otherwise as [`poses::read`].
    pub fn poses(&self, scene_id: u32, object_id: u32, source: &PoseSource) -> Result<BTreeMap<u32, Pose>> {
        let folder = self.scene_folder(scene_id)?;
        let path = match source {
            PoseSource::GroundTruth => folder.join("scene_gt.json"),
            PoseSource::Reference => folder.join("scene_ref.json"),
            PoseSource::File(path) => path.clone(),
        };
        if !path.exists() {
            let remedy = "give the poses with gt (scene_gt.json), ref (scene_ref.json), or as a file";
            return Err(Error::field(&path, "poses", "there is no such file", remedy));
        }
        poses::read(&path, scene_id, object_id)
    }

    fn scene_folder(&self, id: u32) -> Result<&Path> {
        self.scenes.get(&id).map(PathBuf::as_path).ok_or_else(|| {
            let remedy = format!("choose one of the scenes {:?}", self.scene_ids());
            Error::invalid(format!("scene {id}"), format!("not in {}", self.root.display()), remedy)
        })
    }

    /// The folder of meshes: in the root, or beside it where a split was opened.
    fn model_folder(&self) -> Result<PathBuf> {
        let places = [self.root.clone(), self.root.join("..")];
        let mut folders = places.iter().flat_map(|p| MODEL_FOLDERS.map(|name| p.join(name)));
        folders.find(|f| f.is_dir()).ok_or_else(|| {
            let what = self.root.display().to_string();
            Error::invalid(what, "no folder models/ in it", "add models/obj_000001.ply")
        })
    }

    /// Size of an image, which must be that of `camera.json` if it is stated there.
    fn image_size(&self, image: &Path) -> Result<(u32, u32)> {
        let (width, height) = gray::dimensions(image)?;
        let path = self.root.join("camera.json");
        if path.is_file() {
            let document = Document::read(&path)?;
            for (name, found) in [("width", width), ("height", height)] {
                let Some(node) = document.root().optional(name) else { continue };
                let stated = node.whole()?;
                if stated != found {
                    let problem = format!("{stated}, but {} has {found}", image.display());
                    return Err(node.error(problem, "give images and calibration of the same camera"));
                }
            }
        }
        Ok((width, height))
    }
}

/// The camera of one entry of `scene_camera.json`.
fn camera(node: &Node<'_>, size: (u32, u32)) -> Result<Camera> {
    let lens = match node.optional("cam_dist") {
        Some(list) => distortion(&list.numbers()?).map_err(|e| e.in_field(list.path(), list.place()))?,
        None => Default::default(),
    };
    let matrix = node.member("cam_K")?;
    camera_from_matrix(&matrix.array()?, size, lens).map_err(|e| e.in_field(matrix.path(), matrix.place()))
}

/// Scene folders by id: named by a number, with a `scene_camera.json`.
fn scenes_in(place: &Path) -> Result<BTreeMap<u32, PathBuf>> {
    let names = folder_names(place)?;
    let scene = |name: &String| {
        let folder = place.join(name);
        folder.join("scene_camera.json").is_file().then_some((name.parse().ok()?, folder))
    };
    Ok(names.iter().filter_map(scene).collect())
}

/// Images of a scene by id.
fn images_in(scene: &Path) -> Result<BTreeMap<u32, PathBuf>> {
    let Some(folder) = IMAGE_FOLDERS.map(|name| scene.join(name)).into_iter().find(|f| f.is_dir()) else {
        let problem = "no folder gray/ or rgb/ in it";
        return Err(Error::invalid(scene.display().to_string(), problem, "complete the data set"));
    };
    let mut best: BTreeMap<u32, (usize, PathBuf)> = BTreeMap::new();
    for name in entry_names(&folder, |t| !t.is_dir())? {
        let Some((stem, extension)) = name.rsplit_once('.') else { continue };
        let rank = IMAGE_EXTENSIONS.iter().position(|e| extension.eq_ignore_ascii_case(e));
        let (Some(rank), Ok(id)) = (rank, stem.parse()) else { continue };
        let candidate = (rank, folder.join(&name));
        best.entry(id).and_modify(|b| *b = candidate.clone().min(b.clone())).or_insert(candidate);
    }
    Ok(best.into_iter().map(|(id, (_, path))| (id, path)).collect())
}

/// Names of the folders (and links, which may lead to folders) in a folder.
fn folder_names(place: &Path) -> Result<Vec<String>> {
    entry_names(place, |t| !t.is_file())
}

/// Names in a folder whose type passes; names that are not UTF-8 cannot be part of the layout.
fn entry_names(folder: &Path, passes: impl Fn(fs::FileType) -> bool) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
        let entry = entry.map_err(|e| Error::io(folder, e))?;
        if passes(entry.file_type().map_err(|e| Error::io(entry.path(), e))?) {
            names.extend(entry.file_name().into_string());
        }
    }
    Ok(names)
}

#[cfg(test)]
#[path = "bop_tests.rs"]
mod tests;
