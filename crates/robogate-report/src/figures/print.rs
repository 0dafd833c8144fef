//! Figures as PNG and PDF, for programs that do not read SVG. Texts are set in a font of the system.

use std::sync::Arc;

use resvg::tiny_skia::{Color, Pixmap, Transform};
use resvg::usvg::{Options, Tree, fontdb};

/// Width of a PNG in pixels. At 300 dots per inch that is 17 cm, the width of two columns of a paper.
const WIDTH: u32 = 2008;

/// Families without serifs that systems have, the first of them first.
const FAMILIES: [&str; 7] =
    ["Helvetica", "Arial", "Liberation Sans", "DejaVu Sans Condensed", "DejaVu Sans", "Noto Sans", "FreeSans"];

/// Why a figure cannot be drawn.
#[derive(Debug, thiserror::Error, Clone, PartialEq, Eq)]
pub enum PrintError {
    /// The system has no fonts.
    #[error(
        "the system has no font for the texts of the figure.\nHint: install one (Debian: `apt install fonts-dejavu-core`), or \
         write --svg"
    )]
    NoFont,
    /// A library refuses the figure.
    #[error("the figure cannot be drawn: {0}")]
    Drawing(String),
}

/// A figure as a PNG image on a white ground.
///
/// # Errors
/// If the system has no fonts.
pub fn png(svg: &str) -> Result<Vec<u8>, PrintError> {
    let tree = tree(svg)?;
    let scale = WIDTH as f32 / tree.size().width();
    let height = (tree.size().height() * scale).ceil() as u32;
    let mut image = Pixmap::new(WIDTH, height).ok_or_else(|| PrintError::Drawing("it has no height".to_owned()))?;
    image.fill(Color::WHITE);
    resvg::render(&tree, Transform::from_scale(scale, scale), &mut image.as_mut());
    image.encode_png().map_err(|error| PrintError::Drawing(error.to_string()))
}

/// A figure as a page of PDF of its own size, with the font embedded.
///
/// # Errors
/// If the system has no fonts.
pub fn pdf(svg: &str) -> Result<Vec<u8>, PrintError> {
    svg2pdf::to_pdf(&tree(svg)?, svg2pdf::ConversionOptions::default(), svg2pdf::PageOptions::default())
        .map_err(|error| PrintError::Drawing(error.to_string()))
}

fn tree(svg: &str) -> Result<Tree, PrintError> {
    let mut fonts = fontdb::Database::new();
    fonts.load_system_fonts();
    let known = |family: &str| fonts.faces().any(|face| face.families.iter().any(|(name, _)| name == family));
    let other = || fonts.faces().next().and_then(|face| face.families.first()).map(|(name, _)| name.clone());
    let family = FAMILIES.into_iter().find(|family| known(family)).map(str::to_owned).or_else(other);
    let family = family.ok_or(PrintError::NoFont)?;
    fonts.set_sans_serif_family(family.clone());
    let options = Options { font_family: family, fontdb: Arc::new(fonts), ..Options::default() };
    Tree::from_str(svg, &options).map_err(|error| PrintError::Drawing(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SVG: &str = "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"100\" height=\"50\" viewBox=\"0 0 100 50\"><style>\
                       svg { font-family: sans-serif; } .a { fill: #000000; }</style><text class=\"a\" x=\"5\" y=\"40\" \
                       font-size=\"30\">Wm</text></svg>";

    #[test]
    fn texts_are_drawn_on_white() {
        let image = Pixmap::decode_png(&png(SVG).unwrap()).unwrap();
        assert_eq!((image.width(), image.height()), (WIDTH, WIDTH / 2));
        let dark = image.pixels().iter().filter(|pixel| pixel.red() < 64).count();
        let share = dark as f64 / f64::from(WIDTH * WIDTH / 2);
        assert!((0.03..0.3).contains(&share), "{share} of the image is dark");
        assert!(image.pixels().iter().all(|pixel| pixel.alpha() == 255));
    }

    #[test]
    fn a_page_of_pdf_has_the_font() {
        let page = pdf(SVG).unwrap();
        assert!(page.starts_with(b"%PDF-"));
        let text = String::from_utf8_lossy(&page);
        assert!(text.contains("/FontDescriptor") && text.contains("/MediaBox"), "{text}");
    }

    #[test]
    fn what_is_no_svg_is_an_error() {
        assert!(matches!(png("<svg"), Err(PrintError::Drawing(_))));
    }
}
