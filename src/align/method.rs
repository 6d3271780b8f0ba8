//! The methods by name.

use std::fmt;

use super::{Aligner, Edge, ForwardAdditive, InverseCompositional, Paper};

/// A way to align; [`Method::aligner`] makes it with its default choices.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Template gradient, pose-dependent geometry, coarse to fine
    #[default]
    InverseCompositional,
    /// The paper's proposed method as printed, but for the sign of its eqs. (16) and (18)
    Paper,
    /// Gauss-Newton with the frame's gradient at the current pose, coarse to fine
    ForwardAdditive,
    /// Edges of the model, searched along their normals in the frame
    Edge,
}

impl Method {
    /// All of them, the default first.
    pub const ALL: [Self; 4] = [Self::InverseCompositional, Self::Paper, Self::ForwardAdditive, Self::Edge];

    /// The name a person types, and that summaries have.
    pub fn name(self) -> &'static str {
        match self {
            Self::InverseCompositional => "inverse-compositional",
            Self::Paper => "paper",
            Self::ForwardAdditive => "forward-additive",
            Self::Edge => "edge",
        }
    }

    /// The method with its default choices.
    pub fn aligner(self) -> Box<dyn Aligner> {
        match self {
            Self::InverseCompositional => Box::new(InverseCompositional::default()),
            Self::Paper => Box::new(Paper::default()),
            Self::ForwardAdditive => Box::new(ForwardAdditive::default()),
            Self::Edge => Box::new(Edge::default()),
        }
    }

    /// True if the method is meant for the triangles between landmarks as they are: a model for it is trained with
    /// an infinite `max_edge_px`.
    pub fn wants_whole_triangles(self) -> bool {
        self == Self::Paper
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
