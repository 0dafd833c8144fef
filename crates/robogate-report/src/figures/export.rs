//! The figures of a page as files of their own, for papers and slides: SVG without variables and outer styles, and their data as CSV.

use std::collections::BTreeSet;

use robogate_analysis::Analysis;

use crate::Additions;
use crate::document::{Block, Figure, Table, analysis_document};
use crate::html::STYLE;

/// A figure of a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FigureFile {
    /// Its name: the section, and the title in small letters and without numbers.
    pub name: String,
    /// Its title.
    pub title: String,
    /// The figure.
    pub svg: String,
    /// Its data, with a header.
    pub csv: String,
}

/// The figures of the page of an analysis, in its order.
pub fn figure_files(analysis: &Analysis) -> Vec<FigureFile> {
    let document = analysis_document(analysis, &Additions::default());
    let mut files: Vec<FigureFile> = Vec::new();
    for section in &document.sections {
        for figure in figures(&section.blocks) {
            let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
            let words: String = figure.title.chars().map(plain).collect();
            // A number is a count of this run. Scripts name a figure of any run.
            let names = |word: &&str| !word.is_empty() && !word.chars().all(|c| c.is_ascii_digit());
            let words: Vec<&str> = words.split('-').filter(names).collect();
            let base = format!("{}-{}", section.id, words.join("-")).trim_end_matches('-').to_owned();
            let taken = |name: &str| files.iter().any(|file| file.name == name);
            let more = (2..).map(|i| format!("{base}-{i}")).find(|name| !taken(name)).filter(|_| taken(&base));
            let svg = standalone(&figure.svg.0);
            files.push(FigureFile {
                name: more.unwrap_or(base),
                title: figure.title.clone(),
                svg,
                csv: csv(&figure.table),
            });
        }
    }
    files
}

fn figures(blocks: &[Block]) -> Vec<&Figure> {
    let mut found = Vec::new();
    for block in blocks {
        match block {
            Block::Figure(figure) => found.push(figure),
            Block::Grid(grid) => found.extend(grid),
            Block::Group(_, inner) => found.extend(figures(inner)),
            _ => {}
        }
    }
    found
}

/// The element as a file: with a namespace, a size, and the styles of its classes in the light colours of the page.
fn standalone(svg: &str) -> String {
    let attribute = |name: &str| {
        let at = svg.find(&format!("{name}=\""))? + name.len() + 2;
        svg.get(at..)?.split('"').next()
    };
    let sizes: Vec<&str> = attribute("viewBox").unwrap_or_default().split(' ').skip(2).collect();
    let [width, height] = [sizes.first(), sizes.get(1)].map(|size| size.copied().unwrap_or("400"));
    let styles = styles(svg);
    let head = format!("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" ");
    let body = svg.replacen("<svg ", &head, 1);
    let (open, rest) = body.split_once('>').unwrap_or((&body, ""));
    format!("{open}><style>svg {{ font-family: Helvetica, Arial, sans-serif; }}\n{styles}</style>{rest}\n")
}

/// The rules of the page's style for the classes of an element.
fn styles(svg: &str) -> String {
    let classes: BTreeSet<&str> = svg
        .split("class=\"")
        .skip(1)
        .filter_map(|text| text.split('"').next())
        .flat_map(str::split_whitespace)
        .collect();
    let applies = |selector: &str| {
        let own = selector.trim().trim_start_matches("svg ");
        let all_used = |own: &str| own.split('.').skip(1).all(|class| classes.contains(class));
        own == "text" || own.starts_with('.') && !own.contains([' ', ':', '>', '[']) && all_used(own)
    };
    let mut out = String::new();
    for (selectors, body) in rules(STYLE) {
        let kept: Vec<&str> = selectors.split(',').map(str::trim).filter(|selector| applies(selector)).collect();
        let paints = ["fill", "stroke", "font", "paint-order"].iter().any(|property| body.contains(property));
        if !kept.is_empty() && paints {
            out += &format!("{} {{ {} }}\n", kept.join(", "), resolved(body));
        }
    }
    out
}

/// The rules of a style outside of media queries.
fn rules(style: &str) -> Vec<(&str, &str)> {
    let (mut found, mut depth, mut start, mut open) = (Vec::new(), 0_u32, 0, 0);
    for (at, c) in style.char_indices() {
        match c {
            '{' => {
                if depth == 0 {
                    open = at;
                }
                depth += 1;
            }
            '}' => {
                depth = depth.saturating_sub(1);
                if depth == 0 {
                    let selectors = style.get(start..open).unwrap_or_default().trim();
                    if !selectors.starts_with('@') {
                        found.push((selectors, style.get(open + 1..at).unwrap_or_default().trim()));
                    }
                    start = at + 1;
                }
            }
            _ => {}
        }
    }
    found
}

/// Declarations with the values of the variables on a light page.
fn resolved(body: &str) -> String {
    let variables = rules(STYLE).into_iter().find(|(selectors, _)| *selectors == ":root").map_or("", |(_, body)| body);
    let value = |name: &str| {
        let mut declared = variables.split(';').filter_map(|one| one.split_once(':'));
        declared.find(|(known, _)| known.trim() == name).map_or("currentColor", |(_, value)| value.trim())
    };
    let mut parts = body.split("var(");
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let (name, rest) = part.split_once(')').unwrap_or((part, ""));
        out += value(name);
        out += rest;
    }
    out
}

/// A table as values separated by commas.
fn csv(table: &Table) -> String {
    let cell = |text: &str| match text.contains([',', '"', '\n']) {
        true => format!("\"{}\"", text.replace('"', "\"\"")),
        false => text.to_owned(),
    };
    let line = |cells: Vec<String>| cells.join(",") + "\n";
    let head = line(table.columns.iter().map(|column| cell(&column.head)).collect());
    head + &table.rows.iter().map(|row| line(row.iter().map(|text| cell(text)).collect())).collect::<String>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn styles_have_no_variables() {
        let svg = standalone(
            "<svg viewBox=\"0 0 300 40\" role=\"img\"><rect class=\"ci\"/><text class=\"s d\">a</text></svg>",
        );
        assert!(
            svg.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"300\" height=\"40\" viewBox"),
            "{svg}"
        );
        assert!(svg.contains(".ci { fill: #1b1d21; fill-opacity: .28; }") && svg.contains("svg .d"), "{svg}");
        assert!(!svg.contains("var(") && !svg.contains(".hollow") && !svg.contains("currentColor"), "{svg}");
    }

    #[test]
    fn cells_of_csv_are_quoted() {
        use crate::document::Kind::Text;
        let table = Table::new("t", &[("a,b", Text), ("c", Text)], vec![vec!["1 \"x\"".to_owned(), "2".to_owned()]]);
        assert_eq!(csv(&table), "\"a,b\",c\n\"1 \"\"x\"\"\",2\n");
    }
}
