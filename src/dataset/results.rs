//! Result files in the CSV format of the BOP challenge: `scene_id,im_id,obj_id,score,R,t,time`.
//!
//! R holds nine numbers, row-major, t three in millimetres, each list separated by spaces; time is in seconds,
//! -1 where unknown. A score of 0 says that the object was lost in that frame.

use std::io::{self, Write};
use std::path::Path;
use std::str::FromStr;

use csv::StringRecord;
use nalgebra::{Matrix3, Vector3};

use super::file::write_atomically;
use crate::error::{Error, Result};
use crate::geometry::Pose;

/// The columns in their order.
const COLUMNS: [&str; 7] = ["scene_id", "im_id", "obj_id", "score", "R", "t", "time"];

/// What to do about a bad line.
const REMEDY: &str = "each line is scene_id,im_id,obj_id,score,R (9 numbers),t (3 numbers, mm),time (s)";

/// One estimated pose of one object in one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResultRow {
    /// Scene.
    pub scene_id: u32,
    /// Image in the scene.
    pub im_id: u32,
    /// Object.
    pub obj_id: u32,
    /// Confidence; 0 means lost.
    pub score: f64,
    /// `camera_from_object`, metres.
    pub pose: Pose,
    /// Time the estimate took, seconds; `None` where unknown.
    pub time_s: Option<f64>,
}

/// Reads a result file, with or without its header line.
///
/// # Errors
/// [`Error::Io`], or [`Error::Line`] at the first bad line: wrong number of columns, numbers that do not parse
/// or are not finite, R not a rotation.
pub fn read(path: &Path) -> Result<Vec<ResultRow>> {
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(csv::Trim::All)
        .from_path(path)
        .map_err(|e| csv_error(path, e))?;
    let mut rows = Vec::new();
    for (k, record) in reader.records().enumerate() {
        let record = record.map_err(|e| csv_error(path, e))?;
        let line = record.position().map_or(0, csv::Position::line);
        if k == 0 && record.iter().eq(COLUMNS) {
            continue;
        }
        rows.push(row(&record).map_err(|e| e.in_line(path, line))?);
    }
    Ok(rows)
}

fn csv_error(path: &Path, error: csv::Error) -> Error {
    let line = error.position().map_or(1, csv::Position::line);
    match error.into_kind() {
        csv::ErrorKind::Io(source) => Error::io(path, source),
        csv::ErrorKind::Utf8 { .. } => {
            Error::line(path, line, "not UTF-8 text", "save the file as UTF-8 text")
        }
        other => Error::line(path, line, format!("{other:?}"), REMEDY),
    }
}

fn row(record: &StringRecord) -> Result<ResultRow> {
    if record.len() != COLUMNS.len() {
        let problem = format!("{} columns instead of {}", record.len(), COLUMNS.len());
        return Err(Error::invalid("line", problem, REMEDY));
    }
    let r: [f64; 9] = numbers(record, 4)?;
    let t: [f64; 3] = numbers(record, 5)?;
    let pose = Pose::from_matrix(&Matrix3::from_row_slice(&r), Vector3::from(t) / 1000.0)?;
    let [score] = numbers(record, 3)?;
    let [time] = numbers(record, 6)?;
    Ok(ResultRow {
        scene_id: parse(0, &record[0])?,
        im_id: parse(1, &record[1])?,
        obj_id: parse(2, &record[2])?,
        score,
        pose,
        time_s: (time >= 0.0).then_some(time),
    })
}

fn parse<T: FromStr>(column: usize, text: &str) -> Result<T> {
    text.parse()
        .map_err(|_| Error::invalid(COLUMNS[column], format!("{text:?} is not such a number"), REMEDY))
}

fn numbers<const N: usize>(record: &StringRecord, column: usize) -> Result<[f64; N]> {
    let text = &record[column];
    let values: Vec<f64> = text.split_whitespace().map(|s| parse(column, s)).collect::<Result<_>>()?;
    if let Some(bad) = values.iter().find(|v| !v.is_finite()) {
        return Err(Error::invalid(COLUMNS[column], format!("{bad} is not finite"), REMEDY));
    }
    values.try_into().map_err(|found: Vec<f64>| {
        Error::invalid(COLUMNS[column], format!("{} numbers instead of {N}", found.len()), REMEDY)
    })
}

/// Writes a result file with its header line; numbers in the shortest form that reads back exactly.
///
/// # Errors
/// [`Error::Invalid`] for a number that is not finite (nothing is written then), [`Error::Io`].
pub fn write(path: &Path, rows: &[ResultRow]) -> Result<()> {
    rows.iter().try_for_each(check)?;
    write_atomically(path, |out| {
        let mut writer = ResultWriter::new(out)?;
        rows.iter().try_for_each(|row| writer.write(row))
    })
}

/// Refuses a row that could not be read back.
fn check(row: &ResultRow) -> Result<()> {
    let pose = row.pose.matrix();
    if pose.iter().chain(&row.time_s).chain([&row.score]).any(|v| !v.is_finite()) {
        let what = format!("result of scene {}, image {}", row.scene_id, row.im_id);
        return Err(Error::invalid(what, "a number is not finite", "write lost frames with score 0"));
    }
    Ok(())
}

/// Writes result rows one by one, each of them complete before the next begins.
#[derive(Debug)]
pub struct ResultWriter<W: Write>(csv::Writer<W>);

impl<W: Write> ResultWriter<W> {
    /// Writes the header line.
    ///
    /// # Errors
    /// That of `out`.
    pub fn new(out: W) -> io::Result<Self> {
        let mut writer = csv::Writer::from_writer(out);
        writer.write_record(COLUMNS)?;
        writer.flush()?;
        Ok(Self(writer))
    }

    /// Writes one row and hands it to the file system.
    ///
    /// # Errors
    /// That of the underlying writer; `InvalidData` for a number that is not finite.
    pub fn write(&mut self, row: &ResultRow) -> io::Result<()> {
        check(row).map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e))?;
        let r = row.pose.rotation().transpose();
        self.0.write_record([
            row.scene_id.to_string(),
            row.im_id.to_string(),
            row.obj_id.to_string(),
            format!("{:?}", row.score),
            // Column-major of the transpose is row-major.
            joined(r.iter()),
            joined((row.pose.translation() * 1000.0).iter()),
            row.time_s.map_or_else(|| "-1".to_owned(), |t| format!("{t:?}")),
        ])?;
        self.0.flush()
    }
}

fn joined<'a>(values: impl Iterator<Item = &'a f64>) -> String {
    values.map(|v| format!("{v:?}")).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::damage::{damaged, with_file};
    use nalgebra::Vector6;
    use proptest::prelude::*;

    const SAMPLE: &[u8] = b"scene_id,im_id,obj_id,score,R,t,time\n\
        1,0,5,0.9,1 0 0 0 1 0 0 0 1,10 -20 500,0.012\n1,1,5,0,0 -1 0 1 0 0 0 0 1,1e1 2.5 600.125,-1\n";

    #[test]
    fn reads_by_hand() {
        let rows = with_file("r.csv", SAMPLE, read).unwrap();
        assert_eq!(rows.len(), 2, "the header is no row");
        let expected = Vector3::new(0.01, -0.02, 0.5);
        assert!((rows[0].pose.translation() - expected).norm() < 1e-15, "metres");
        assert_eq!((rows[0].scene_id, rows[0].im_id, rows[0].obj_id), (1, 0, 5), "ids");
        assert_eq!((rows[0].score, rows[0].time_s), (0.9, Some(0.012)), "score and time");
        assert!((rows[1].pose.rotation()[(1, 0)] - 1.0).abs() < 1e-12, "R is row-major");
        assert_eq!((rows[1].score, rows[1].time_s), (0.0, None), "lost, time unknown");
        let headless = with_file("r.csv", &SAMPLE[37..], read).unwrap();
        assert_eq!(headless, rows, "the header may be missing");
    }

    #[test]
    fn bad_lines_are_named() {
        let cases = [
            ("1,1,5,0,", "1,1,5,", "columns"),
            ("1,1,5,0,", "1,-1,5,0,", "im_id"),
            ("1,1,5,0,", "1,1,5,high,", "score"),
            ("1,1,5,0,", "1,1,5,NaN,", "score"),
            ("0 -1 0 1 0 0 0 0 1", "0 -1 0 1 0 0 0 0", "8 numbers"),
            ("0 -1 0 1 0 0 0 0 1", "0 -1 0 1 0 0 0 0 2", "orthonormal"),
            ("2.5", "inf", "t: inf"),
            ("-1\n", "\n", "time"),
        ];
        let text = String::from_utf8(SAMPLE.to_vec()).unwrap();
        let failed: Vec<String> = cases
            .iter()
            .filter_map(|(from, to, expected)| {
                let (good, bad) = text.split_at(text.find("1,1,5").unwrap());
                let bytes = good.to_owned() + &bad.replacen(from, to, 1);
                match with_file("r.csv", bytes.as_bytes(), read) {
                    Ok(_) => Some(format!("{to:?} was accepted")),
                    Err(e) => {
                        let e = e.to_string();
                        (!e.contains("r.csv:3:") || !e.contains(expected)).then(|| format!("{to:?}: {e}"))
                    }
                }
            })
            .collect();
        assert!(failed.is_empty(), "{failed:#?}");
    }

    #[test]
    fn missing_files_and_bytes_that_are_no_text_are_named() {
        let text = read(Path::new("/nowhere/r.csv")).unwrap_err().to_string();
        assert!(text.contains("/nowhere/r.csv"), "{text}");
        let bytes = [SAMPLE, b"1,2,5,\xff"].concat();
        let text = with_file("r.csv", &bytes, read).unwrap_err().to_string();
        assert!(text.contains("r.csv:4: not UTF-8"), "{text}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_not_written() {
        let mut row = with_file("r.csv", SAMPLE, read).unwrap()[0];
        row.score = f64::NAN;
        with_file("r.csv", SAMPLE, |path| {
            assert!(write(path, &[row]).is_err(), "NaN");
            assert_eq!(std::fs::read(path).unwrap(), SAMPLE, "the old file stays");
        });
    }

    proptest! {
        #[test]
        fn rows_round_trip(p in prop::array::uniform6(-1.5..1.5f64), score in 0.0..1.0f64, time in 0.0..9.0f64) {
            let pose = Pose::from_params(&Vector6::from(p));
            let row = ResultRow { scene_id: 1, im_id: 2, obj_id: 3, score, pose, time_s: Some(time) };
            let again = with_file("r.csv", b"", |path| {
                write(path, &[row]).expect("written");
                read(path).expect("read")
            })[0];
            prop_assert_eq!((again.score, again.time_s), (score, Some(time)));
            prop_assert!((again.pose.matrix() - pose.matrix()).norm() < 1e-12, "{:?}", again.pose);
        }

        #[test]
        fn no_damaged_file_panics(bytes in damaged(SAMPLE)) {
            let _ = with_file("r.csv", &bytes, read);
        }
    }
}
