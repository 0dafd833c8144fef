//! Pages of text and tables as PDF 1.4, without a browser and without fonts of this machine.
//!
//! The fonts are Helvetica and Helvetica-Bold, which every PDF reader has (ISO 32000-1, 9.6.2.2); the encoding is
//! WinAnsiEncoding. Characters outside it are replaced by a question mark. The file has no date and no compression: equal
//! pages give equal bytes.

mod font;

use std::fmt::Write;

use font::{Font, encoded};

/// A4 in points (1/72 inch).
const PAGE: [f64; 2] = [595.28, 841.89];
const MARGIN: f64 = 54.0;
/// Size of text in points.
const TEXT: f64 = 9.5;
/// Distance between lines, relative to the size of the text.
const LEADING: f64 = 1.35;
/// Space between the columns of a table.
const GUTTER: f64 = 8.0;

/// A column of a table.
pub(crate) struct PdfColumn {
    pub(crate) head: &'static str,
    /// Its share of the width of the text.
    pub(crate) share: f64,
}

/// A colour: red, green, blue from 0 to 1.
pub(crate) type Colour = [f64; 3];
const BLACK: Colour = [0.0; 3];
const GREY: Colour = [0.4; 3];

/// A document that grows downwards.
pub(crate) struct Pdf {
    /// The drawing operators of each page.
    pages: Vec<String>,
    /// Distance of the next line's top from the bottom of the page.
    y: f64,
}

impl Pdf {
    pub(crate) fn new() -> Self {
        Self { pages: vec![String::new()], y: PAGE[1] - MARGIN }
    }

    /// A line of large text.
    pub(crate) fn title(&mut self, text: &str, size: f64, colour: Colour) {
        self.lines(text, Font::Bold, size, colour, MARGIN, width());
        self.space(4.0);
    }

    /// A heading, which stays on the page of its first lines.
    pub(crate) fn heading(&mut self, text: &str) {
        self.space(10.0);
        self.need(5.0 * TEXT * LEADING);
        self.lines(text, Font::Bold, 12.0, BLACK, MARGIN, width());
        self.space(3.0);
    }

    /// A paragraph.
    pub(crate) fn paragraph(&mut self, text: &str) {
        self.lines(text, Font::Plain, TEXT, BLACK, MARGIN, width());
        self.space(4.0);
    }

    /// Names and values.
    pub(crate) fn facts(&mut self, facts: &[(String, String)]) {
        let columns = [PdfColumn { head: "", share: 0.22 }, PdfColumn { head: "", share: 0.78 }];
        let rows: Vec<Vec<String>> = facts.iter().map(|(name, value)| vec![name.clone(), value.clone()]).collect();
        self.table(&columns, &rows);
    }

    /// A table. Its head is repeated on each page; columns without a head have none.
    pub(crate) fn table(&mut self, columns: &[PdfColumn], rows: &[Vec<String>]) {
        let head: Vec<String> = columns.iter().map(|column| column.head.to_owned()).collect();
        let has_head = head.iter().any(|head| !head.is_empty());
        if has_head {
            self.row(columns, &head, Font::Bold);
        }
        for row in rows {
            let page = self.pages.len();
            self.need(height(columns, row, Font::Plain));
            if has_head && self.pages.len() > page {
                self.row(columns, &head, Font::Bold);
            }
            self.row(columns, row, Font::Plain);
        }
        self.space(4.0);
    }

    fn row(&mut self, columns: &[PdfColumn], cells: &[String], font: Font) {
        let height = height(columns, cells, font);
        self.need(height);
        let top = self.y;
        let mut x = MARGIN;
        for (column, cell) in columns.iter().zip(cells) {
            self.y = top;
            self.lines(cell, font, TEXT, BLACK, x, column.share * width() - GUTTER);
            x += column.share * width();
        }
        self.y = top - height;
        self.put(format_args!("0.8 G 0.5 w {MARGIN:.2} {0:.2} m {1:.2} {0:.2} l S\n", self.y + 2.0, PAGE[0] - MARGIN));
    }

    /// Writes text in lines of at most `width` points.
    fn lines(&mut self, text: &str, font: Font, size: f64, colour: Colour, x: f64, width: f64) {
        for line in wrapped(text, font, size, width) {
            self.need(size * LEADING);
            self.y -= size * LEADING;
            let operators = shown(&line, font, size, colour, [x, self.y + 0.3 * size]);
            self.put(format_args!("{operators}"));
        }
    }

    fn put(&mut self, operators: std::fmt::Arguments<'_>) {
        if let Some(page) = self.pages.last_mut() {
            let _ = page.write_fmt(operators);
        }
    }

    fn space(&mut self, points: f64) {
        self.y -= points;
    }

    /// Begins a page if less than `points` are left on this one.
    fn need(&mut self, points: f64) {
        // The footer has a line of its own.
        if self.y - points < MARGIN + 2.0 * TEXT {
            self.pages.push(String::new());
            self.y = PAGE[1] - MARGIN;
        }
    }

    /// The file. `footer` is at the end of each page, before its number.
    pub(crate) fn finish(mut self, title: &str, footer: &str) -> Vec<u8> {
        let pages = self.pages.len();
        for (at, page) in self.pages.iter_mut().enumerate() {
            let text = format!("{footer} - page {} of {pages}", at + 1);
            page.push_str(&shown(&text, Font::Plain, 8.0, GREY, [MARGIN, MARGIN]));
        }
        file(title, &self.pages)
    }
}

/// The operators that show a line with its baseline at `x`, `y`.
fn shown(line: &str, font: Font, size: f64, [red, green, blue]: Colour, [x, y]: [f64; 2]) -> String {
    let hex = encoded(line).iter().fold(String::new(), |mut hex, byte| {
        // Writing to a string cannot fail, here and below.
        let _ = write!(hex, "{byte:02X}");
        hex
    });
    format!("BT /{} {size} Tf {red} {green} {blue} rg {x:.2} {y:.2} Td <{hex}> Tj ET\n", font.name())
}

/// The width of the text on a page.
fn width() -> f64 {
    PAGE[0] - 2.0 * MARGIN
}

fn height(columns: &[PdfColumn], cells: &[String], font: Font) -> f64 {
    let lines = columns
        .iter()
        .zip(cells)
        .map(|(column, cell)| wrapped(cell, font, TEXT, column.share * width() - GUTTER).len());
    lines.max().unwrap_or(0).max(1) as f64 * TEXT * LEADING + 4.0
}

/// Breaks text into lines of at most `width` points, at spaces or, for a longer word, within it.
fn wrapped(text: &str, font: Font, size: f64, width: f64) -> Vec<String> {
    let mut lines = Vec::new();
    for paragraph in text.split('\n') {
        let mut line = String::new();
        for word in paragraph.split(' ') {
            let joined = if line.is_empty() { word.to_owned() } else { format!("{line} {word}") };
            if font.width(&joined, size) <= width {
                line = joined;
                continue;
            }
            if !line.is_empty() {
                lines.push(std::mem::take(&mut line));
            }
            for c in word.chars() {
                line.push(c);
                if font.width(&line, size) > width && line.chars().count() > 1 {
                    line.pop();
                    lines.push(std::mem::replace(&mut line, c.to_string()));
                }
            }
        }
        lines.push(line);
    }
    lines
}

/// The objects of the file: catalogue, tree of pages, fonts, information, and a page with its content for each page.
fn file(title: &str, pages: &[String]) -> Vec<u8> {
    let first = 6;
    let kids: Vec<String> = (0..pages.len()).map(|at| format!("{} 0 R", first + 2 * at)).collect();
    let font =
        |font: Font| format!("<< /Type /Font /Subtype /Type1 /BaseFont /{} /Encoding /WinAnsiEncoding >>", font.base());
    let title: String = title.encode_utf16().map(|unit| format!("{unit:04X}")).collect();
    let mut objects = vec![
        "<< /Type /Catalog /Pages 2 0 R /Lang (en) /ViewerPreferences << /DisplayDocTitle true >> >>".to_owned(),
        format!("<< /Type /Pages /Kids [{}] /Count {} >>", kids.join(" "), pages.len()),
        font(Font::Plain),
        font(Font::Bold),
        format!("<< /Title <FEFF{title}> /Producer (RoboGate {}) >>", env!("CARGO_PKG_VERSION")),
    ];
    for (at, page) in pages.iter().enumerate() {
        let [wide, high] = PAGE;
        objects.push(format!(
            "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {wide} {high}] /Resources << /Font << /{} 3 0 R /{} 4 0 R >> >> \
             /Contents {} 0 R >>",
            Font::Plain.name(),
            Font::Bold.name(),
            first + 2 * at + 1
        ));
        objects.push(format!("<< /Length {} >>\nstream\n{page}endstream", page.len()));
    }
    let mut out = String::from("%PDF-1.4\n");
    let mut places = Vec::new();
    for (at, object) in objects.iter().enumerate() {
        places.push(out.len());
        let _ = write!(out, "{} 0 obj\n{object}\nendobj\n", at + 1);
    }
    let start = out.len();
    let _ = write!(out, "xref\n0 {}\n0000000000 65535 f \n", objects.len() + 1);
    for place in places {
        let _ = writeln!(out, "{place:010} 00000 n ");
    }
    let _ =
        write!(out, "trailer\n<< /Size {} /Root 1 0 R /Info 5 0 R >>\nstartxref\n{start}\n%%EOF\n", objects.len() + 1);
    out.into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_fit_their_width() {
        let text = format!("some words {} and more", "0123456789abcdef".repeat(8));
        let lines = wrapped(&text, Font::Plain, TEXT, 150.0);
        assert!(lines.iter().all(|line| Font::Plain.width(line, TEXT) <= 150.0), "{lines:?}");
        assert_eq!(lines.concat().replace(' ', ""), text.replace(' ', ""));
        assert_eq!(wrapped("", Font::Bold, TEXT, 10.0), [""]);
    }

    #[test]
    fn long_tables_continue_on_pages() {
        let mut pdf = Pdf::new();
        let columns = [PdfColumn { head: "row", share: 0.5 }, PdfColumn { head: "text", share: 0.5 }];
        let rows: Vec<Vec<String>> = (0..200).map(|i| vec![i.to_string(), "wide ".repeat(30)]).collect();
        pdf.table(&columns, &rows);
        let text = String::from_utf8(pdf.finish("t", "f")).unwrap();
        let pages = text.matches("/Type /Page /Parent").count();
        assert!(pages > 5, "{pages} pages");
        // Each page repeats the head: the word "row" in hexadecimal.
        assert_eq!(text.matches("<726F77>").count(), pages);
        assert!(text.contains(&format!("/Count {pages} >>")));
    }

    #[test]
    fn offsets_point_at_objects() {
        let mut pdf = Pdf::new();
        pdf.paragraph("text");
        let bytes = pdf.finish("title", "footer");
        let text = String::from_utf8(bytes).unwrap();
        let table = text.split("0000000000 65535 f \n").nth(1).unwrap();
        for (at, line) in table.lines().take_while(|line| line.ends_with(" n ")).enumerate() {
            let place: usize = line[..10].parse().unwrap();
            assert!(text[place..].starts_with(&format!("{} 0 obj", at + 1)), "{line}");
        }
    }
}
