//! A table that can be written as Markdown and as HTML.

use std::fmt::Write as _;

/// A table: text in the first columns, numbers in the others.
#[derive(Debug, Clone, Default)]
pub(super) struct Sheet {
    /// Column heads.
    pub(super) head: Vec<String>,
    /// How many of the first columns are text.
    pub(super) text_columns: usize,
    pub(super) rows: Vec<Row>,
}

/// One row; the kind decides how it looks.
#[derive(Debug, Clone)]
pub(super) struct Row {
    pub(super) kind: Kind,
    pub(super) cells: Vec<String>,
}

/// What a row is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// A heading over the rows that follow, one cell.
    Heading,
    /// Numbers of other data, printed elsewhere.
    Published,
    /// Numbers measured here.
    Measured,
}

impl Sheet {
    pub(super) fn new(head: &[&str], text_columns: usize) -> Self {
        Self { head: head.iter().map(|&h| h.to_owned()).collect(), text_columns, rows: Vec::new() }
    }

    pub(super) fn push(&mut self, kind: Kind, cells: Vec<String>) {
        self.rows.push(Row { kind, cells });
    }

    /// GitHub's tables.
    pub(super) fn markdown(&self) -> String {
        let mut text = format!("| {} |\n|", self.head.join(" | "));
        for k in 0..self.head.len() {
            text.push_str(if k < self.text_columns { " --- |" } else { " ---: |" });
        }
        text.push('\n');
        for row in &self.rows {
            let mut cells = row.cells.clone();
            cells.resize(self.head.len(), String::new());
            if row.kind == Kind::Heading {
                cells[0] = format!("**{}**", cells[0]);
            }
            // A string takes any text.
            let _ = writeln!(text, "| {} |", cells.join(" | "));
        }
        text
    }

    /// A table in a box that scrolls where the window is narrow.
    pub(super) fn html(&self) -> String {
        let class = |k: usize| if k < self.text_columns { " class=\"text\"" } else { "" };
        let mut text = String::from("<div class=\"scroll\"><table><thead><tr>");
        for (k, h) in self.head.iter().enumerate() {
            let _ = write!(text, "<th scope=\"col\"{}>{}</th>", class(k), escape(h));
        }
        text.push_str("</tr></thead><tbody>\n");
        for row in &self.rows {
            let kind = match row.kind {
                Kind::Heading => "heading",
                Kind::Published => "published",
                Kind::Measured => "measured",
            };
            let first = if row.cells[0].is_empty() { "" } else { " first" };
            let _ = write!(text, "<tr class=\"{kind}{first}\">");
            if row.kind == Kind::Heading {
                let (span, title) = (self.head.len(), escape(&row.cells[0]));
                let _ = write!(text, "<th scope=\"colgroup\" colspan=\"{span}\">{title}</th>");
            } else {
                for (k, cell) in row.cells.iter().enumerate() {
                    let _ = write!(text, "<td{}>{}</td>", class(k), escape(cell));
                }
            }
            text.push_str("</tr>\n");
        }
        text.push_str("</tbody></table></div>\n");
        text
    }
}

/// Text as it stands in HTML.
pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A number with about three digits that count, or a dash.
pub(super) fn number(value: Option<f64>) -> String {
    let Some(v) = value.filter(|v| v.is_finite()) else { return "–".into() };
    let digits = match v.abs() {
        m if m >= 100.0 => 0,
        m if m >= 10.0 => 1,
        m if m >= 1.0 => 2,
        m if m >= 0.1 => 3,
        0.0 => 0,
        _ => 4,
    };
    format!("{v:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_hold_every_cell() {
        let mut sheet = Sheet::new(&["method", "x (mm)"], 1);
        sheet.push(Kind::Heading, vec!["Sequence 1".into()]);
        sheet.push(Kind::Measured, vec!["a < b".into(), number(Some(0.012_34))]);
        let markdown = sheet.markdown();
        assert_eq!(
            markdown,
            "| method | x (mm) |\n| --- | ---: |\n| **Sequence 1** |  |\n| a < b | 0.0123 |\n"
        );
        let html = sheet.html();
        assert!(
            html.contains("a &lt; b") && html.contains("0.0123") && html.contains("colspan=\"2\""),
            "{html}"
        );
    }

    #[test]
    fn numbers_keep_three_digits() {
        let shown: Vec<String> =
            [Some(123.4), Some(12.34), Some(1.234), Some(0.1234), Some(0.0), None, Some(f64::NAN)]
                .map(number)
                .into();
        assert_eq!(shown, ["123", "12.3", "1.23", "0.123", "0", "–", "–"]);
    }
}
