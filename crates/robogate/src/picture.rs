//! Images as PNG files, and several images on one contact sheet.

use std::path::Path;

use anyhow::{Context, bail};
use robogate_core::Image;
use robogate_dictionary::files;

/// Space between the images of a sheet, in pixels.
const GAP: usize = 4;
/// Height of a caption, in pixels: a letter with a margin.
const CAPTION: usize = 13;
/// Width and height of a letter, in pixels.
const LETTER: [usize; 2] = [5, 7];

const PAPER: [u8; 3] = [250, 250, 248];
const INK: [u8; 3] = [70, 74, 80];

/// Writes an image as PNG. Returns an error if the file already exists.
pub(crate) fn write(path: &Path, image: &Image) -> anyhow::Result<()> {
    let bytes = png(image).with_context(|| format!("cannot encode {}", path.display()))?;
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        files::create_folders(folder).with_context(|| format!("cannot create the folder {}", folder.display()))?;
    }
    create(path, &bytes)
}

/// Writes a new file. Returns an error if it already exists.
pub(crate) fn create(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    match files::write_new(path, bytes) {
        Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {
            bail!("{}: already exists. Remove it, or choose another path", path.display())
        }
        written => written.with_context(|| format!("cannot write {}", path.display())),
    }
}

/// Encodes an image as PNG.
pub(crate) fn png(image: &Image) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, u32::try_from(image.width)?, u32::try_from(image.height)?);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    encoder.set_compression(png::Compression::High);
    encoder.write_header()?.write_image_data(&image.rgb)?;
    Ok(bytes)
}

/// Arranges images of one size in rows of `columns`, each with a caption below it.
pub(crate) fn sheet(pictures: &[(String, Image)], columns: usize) -> Image {
    let (wide, high) = pictures.first().map_or((0, 0), |(_, image)| (image.width, image.height));
    let columns = columns.clamp(1, pictures.len().max(1));
    let rows = pictures.len().div_ceil(columns);
    let cell = [wide + GAP, high + CAPTION + GAP];
    let (width, height) = (columns * cell[0] + GAP, rows * cell[1] + GAP);
    let mut rgb: Vec<u8> = PAPER.iter().copied().cycle().take(3 * width * height).collect();
    for (i, (caption, image)) in pictures.iter().enumerate() {
        let (left, top) = (GAP + i % columns * cell[0], GAP + i / columns * cell[1]);
        for (row, line) in image.rgb.chunks_exact(3 * wide.max(1)).take(high).enumerate() {
            let at = 3 * ((top + row) * width + left);
            rgb[at..at + line.len()].copy_from_slice(line);
        }
        let most = wide / (LETTER[0] + 1);
        for (k, letter) in caption.chars().take(most).enumerate() {
            let x = left + k * (LETTER[0] + 1);
            for (row, bits) in glyph(letter).into_iter().enumerate() {
                for column in (0..LETTER[0]).filter(|column| bits >> (LETTER[0] - 1 - column) & 1 == 1) {
                    let at = 3 * ((top + high + 3 + row) * width + x + column);
                    rgb[at..at + 3].copy_from_slice(&INK);
                }
            }
        }
    }
    Image { camera: "sheet".to_owned(), width, height, rgb }
}

/// The bitmap of a letter: rows from the top, five bits each, with the leftmost pixel in the highest bit. Lower-case
/// letters appear as capitals, and unsupported characters as a dash.
fn glyph(letter: char) -> [u8; 7] {
    match letter.to_ascii_lowercase() {
        ' ' => [0; 7],
        '_' => [0, 0, 0, 0, 0, 0, 31],
        '.' => [0, 0, 0, 0, 0, 12, 12],
        '0' => [14, 17, 19, 21, 25, 17, 14],
        '1' => [4, 12, 4, 4, 4, 4, 14],
        '2' => [14, 17, 1, 2, 4, 8, 31],
        '3' => [31, 2, 4, 2, 1, 17, 14],
        '4' => [2, 6, 10, 18, 31, 2, 2],
        '5' => [31, 16, 30, 1, 1, 17, 14],
        '6' => [6, 8, 16, 30, 17, 17, 14],
        '7' => [31, 1, 2, 4, 8, 8, 8],
        '8' => [14, 17, 17, 14, 17, 17, 14],
        '9' => [14, 17, 17, 15, 1, 2, 12],
        'a' => [14, 17, 17, 31, 17, 17, 17],
        'b' => [30, 17, 17, 30, 17, 17, 30],
        'c' => [14, 17, 16, 16, 16, 17, 14],
        'd' => [28, 18, 17, 17, 17, 18, 28],
        'e' => [31, 16, 16, 30, 16, 16, 31],
        'f' => [31, 16, 16, 30, 16, 16, 16],
        'g' => [14, 17, 16, 23, 17, 17, 15],
        'h' => [17, 17, 17, 31, 17, 17, 17],
        'i' => [14, 4, 4, 4, 4, 4, 14],
        'j' => [7, 2, 2, 2, 2, 18, 12],
        'k' => [17, 18, 20, 24, 20, 18, 17],
        'l' => [16, 16, 16, 16, 16, 16, 31],
        'm' => [17, 27, 21, 21, 17, 17, 17],
        'n' => [17, 17, 25, 21, 19, 17, 17],
        'o' => [14, 17, 17, 17, 17, 17, 14],
        'p' => [30, 17, 17, 30, 16, 16, 16],
        'q' => [14, 17, 17, 17, 21, 18, 13],
        'r' => [30, 17, 17, 30, 20, 18, 17],
        's' => [15, 16, 16, 14, 1, 1, 30],
        't' => [31, 4, 4, 4, 4, 4, 4],
        'u' => [17, 17, 17, 17, 17, 17, 14],
        'v' => [17, 17, 17, 17, 17, 10, 4],
        'w' => [17, 17, 17, 21, 21, 21, 10],
        'x' => [17, 17, 10, 4, 10, 17, 17],
        'y' => [17, 17, 17, 10, 4, 4, 4],
        'z' => [31, 1, 2, 4, 8, 16, 31],
        _ => [0, 0, 0, 31, 0, 0, 0],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(color: u8) -> Image {
        Image { camera: "front".to_owned(), width: 40, height: 30, rgb: vec![color; 3 * 40 * 30] }
    }

    #[test]
    fn png_round_trip_is_exact() {
        let mut image = plain(7);
        image.rgb[3 * 41] = 200;
        let bytes = png(&image).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
        let mut rgb = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut rgb).unwrap();
        assert_eq!((info.width, info.height, info.color_type), (40, 30, png::ColorType::Rgb));
        assert_eq!(rgb, image.rgb);
    }

    #[test]
    fn sheet_places_every_image() {
        let pictures: Vec<_> = (0..5).map(|i| (format!("case-{i}"), plain(i * 40))).collect();
        let sheet = sheet(&pictures, 3);
        assert_eq!((sheet.width, sheet.height), (3 * 44 + 4, 2 * 47 + 4));
        assert_eq!(sheet.rgb.len(), 3 * sheet.width * sheet.height);
        // The centre of the fifth image: second row, second column.
        let at = 3 * ((4 + 47 + 15) * sheet.width + 4 + 44 + 20);
        assert_eq!(sheet.rgb[at], 160);
        assert_eq!(super::sheet(&[], 3).rgb.len(), 3 * 8 * 4);
    }

    #[test]
    fn existing_files_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new").join("a.png");
        write(&path, &plain(1)).unwrap();
        let before = std::fs::read(&path).unwrap();
        let error = write(&path, &plain(2)).unwrap_err().to_string();
        assert!(error.contains("already exists"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), before);
    }
}
