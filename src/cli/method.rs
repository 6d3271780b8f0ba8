//! `--method` and `--paper-order`: how to align.

use crate::align::{Aligner, Method, Order, Paper, PaperOptions};
use crate::model::Model;

/// Which side the inverse increment of `--method paper` goes to.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub(super) struct OrderArg {
    /// Side of H on which `--method paper` puts the inverse increment; left, as printed, if not given
    #[arg(long, value_enum, value_name = "left|right")]
    paper_order: Option<Order>,
}

impl OrderArg {
    /// The order, for these methods; an error if it is given and `paper` is not among them.
    pub(super) fn among(self, methods: &[Method]) -> anyhow::Result<Order> {
        anyhow::ensure!(
            self.paper_order.is_none() || methods.contains(&Method::Paper),
            "--paper-order is a choice of the method paper; leave it out, or choose that method"
        );
        Ok(self.paper_order.unwrap_or_default())
    }
}

/// A method with its choices.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub(super) struct MethodArgs {
    /// How to align
    #[arg(long, value_enum, default_value_t)]
    pub(super) method: Method,
    #[command(flatten)]
    order: OrderArg,
}

impl MethodArgs {
    /// The method; an error if a choice is given that it does not have.
    pub(super) fn aligner(self) -> anyhow::Result<Box<dyn Aligner>> {
        Ok(aligner(self.method, self.order.among(&[self.method])?))
    }

    /// Warns of a model that the method was not made for, and says so for the summary.
    pub(super) fn misfit(self, model: &Model) -> Option<String> {
        let misfit = self.method.wants_whole_triangles() && model.shape.is_cut();
        misfit.then(|| {
            let text = format!(
                "method {} is made for whole triangles, and the model's are cut; train it with --whole-triangles",
                self.method
            );
            tracing::warn!("{text}");
            text
        })
    }
}

/// The method with its default choices but for the order.
pub(super) fn aligner(method: Method, order: Order) -> Box<dyn Aligner> {
    match method {
        Method::Paper => Box::new(Paper::new(PaperOptions { order, ..PaperOptions::default() })),
        other => other.aligner(),
    }
}
