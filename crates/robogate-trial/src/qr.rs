//! A QR code of a short text, so that a phone need not type the address of the page.
//!
//! Byte mode, error correction level L, versions 1 to 5, mask 0. Source: ISO/IEC 18004:2015.

/// Data and error correction codewords of versions 1 to 5 at level L, which have one block.
const BLOCKS: [(usize, usize); 5] = [(19, 7), (34, 10), (55, 15), (80, 20), (108, 26)];
/// The format information of level L with mask 0, with its error correction.
const FORMAT: u32 = 0b111_0111_1100_0100;

/// The modules of a code, row by row. `true` is dark. `None` if the text has more than 106 bytes.
pub fn qr(text: &str) -> Option<Vec<Vec<bool>>> {
    // Mode and length need 12 bits.
    let version = BLOCKS.iter().position(|(data, _)| text.len() + 2 <= *data)?;
    let (data, corrections) = BLOCKS[version];
    let mut bits = vec![false, true, false, false];
    let mut push = |byte: u8| bits.extend((0..8).rev().map(|at| byte >> at & 1 == 1));
    push(text.len() as u8);
    text.bytes().for_each(&mut push);
    bits.resize(8 * (text.len() + 2), false);
    let mut codewords: Vec<u8> =
        bits.chunks(8).map(|byte| byte.iter().fold(0, |sum, bit| sum << 1 | u8::from(*bit))).collect();
    let padding = data - codewords.len();
    codewords.extend([0xec, 0x11].into_iter().cycle().take(padding));
    codewords.extend(correction(&codewords, corrections));
    Some(placed(&codewords, 21 + 4 * version))
}

/// The product in GF(256) with the polynomial of QR codes, 0x11d.
fn product(a: u8, b: u8) -> u8 {
    (0..8).rev().fold(0, |sum: u8, at| {
        let doubled = sum << 1 ^ if sum & 0x80 != 0 { 0x1d } else { 0 };
        doubled ^ if b >> at & 1 == 1 { a } else { 0 }
    })
}

/// The Reed-Solomon codewords of `data`.
fn correction(data: &[u8], count: usize) -> Vec<u8> {
    let mut generator = vec![0; count];
    generator[count - 1] = 1;
    let mut root = 1;
    for _ in 0..count {
        for at in 0..count {
            generator[at] = product(generator[at], root) ^ generator.get(at + 1).copied().unwrap_or(0);
        }
        root = product(root, 2);
    }
    let mut rest = vec![0; count];
    for byte in data {
        let factor = byte ^ rest.remove(0);
        rest.push(0);
        rest.iter_mut().zip(&generator).for_each(|(rest, term)| *rest ^= product(*term, factor));
    }
    rest
}

/// The module of a finder, timing or alignment pattern. `None` elsewhere.
fn pattern(y: usize, x: usize, size: usize) -> Option<bool> {
    let distance = |row: usize, column: usize| y.abs_diff(row).max(x.abs_diff(column));
    let finder = distance(3, 3).min(distance(3, size - 4)).min(distance(size - 4, 3));
    let alignment = distance(size - 7, size - 7);
    match (finder, alignment) {
        // With its light border.
        (0..=4, _) => Some(finder != 2 && finder != 4),
        _ if y == 6 || x == 6 => Some((x + y).is_multiple_of(2)),
        (_, 0..=2) if size > 21 => Some(alignment != 1),
        _ => None,
    }
}

/// Places patterns, format and codewords on a square of `size` modules.
fn placed(codewords: &[u8], size: usize) -> Vec<Vec<bool>> {
    let row = |y| (0..size).map(|x| pattern(y, x, size)).collect();
    let mut modules: Vec<Vec<Option<bool>>> = (0..size).map(row).collect();
    for at in 0..15 {
        let bit = Some(FORMAT >> at & 1 == 1);
        let (along, across) = match at {
            0..6 => (at, size - 1 - at),
            6..8 => (at + 1, size - 1 - at),
            _ => (size - 15 + at, if at == 8 { 7 } else { 14 - at }),
        };
        modules[along][8] = bit;
        modules[8][across] = bit;
    }
    modules[size - 8][8] = Some(true);
    let mut bits = codewords.iter().flat_map(|byte| (0..8).rev().map(move |at| byte >> at & 1 == 1));
    let mut up = true;
    // Pairs of columns from the right; the column of the timing pattern is skipped.
    for right in (0..size).rev().step_by(2).map(|column| if column < 7 { column.saturating_sub(1) } else { column }) {
        for step in 0..size {
            let y = if up { size - 1 - step } else { step };
            for x in [right, right.wrapping_sub(1)] {
                if let Some(module @ None) = modules[y].get_mut(x) {
                    *module = Some(bits.next().unwrap_or(false) ^ (y + x).is_multiple_of(2));
                }
            }
        }
        up = !up;
    }
    modules.into_iter().map(|row| row.into_iter().map(|module| module == Some(true)).collect()).collect()
}

/// The code as text: two rows of modules per line, dark modules as spaces, for terminals with a dark background.
pub fn qr_text(modules: &[Vec<bool>]) -> String {
    let size = modules.len();
    let light = |y: usize, x: usize| {
        let inside = |at: usize| at.checked_sub(2).filter(|at| *at < size);
        !inside(y).zip(inside(x)).is_some_and(|(y, x)| modules[y][x])
    };
    let mut out = String::new();
    for y in (0..size + 4).step_by(2) {
        out.extend((0..size + 4).map(|x| match (light(y, x), y + 1 < size + 4 && light(y + 1, x)) {
            (true, true) => '█',
            (true, false) => '▀',
            (false, true) => '▄',
            (false, false) => ' ',
        }));
        out.push('\n');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rows of the same codes by qrcode 8.2 (Python), as hexadecimal numbers.
    #[test]
    fn codes_agree_with_another_encoder() {
        let address = "http://192.168.0.17:7390/#token=0123456789abcdef0123456789abcdef";
        let small = "1fcb7f 104e41 175b5d 174a5d 17455d 104141 1fd57f 1b00 1dfec4 161046 bcd11 \
                     b1844 6d155 12aa 1fd6ef 105fb8 175aed 174c46 175911 105046 1fdd57";
        let large = "1fc466e7f 104833641 17525505d 17496675d 174966e5d 104733341 1fd55557f 12eec00 \
                     1df1aa9c4 48b8886d 1cd711041 f3daad9a 3c6aab41 188e880e5 47c0099b 23addafa \
                     10c188c63 18b388465 e39904b d1599e0a 1d6e4ce6b dae0cc69 1048844ff d1e3b86a \
                     114d0cdf8 178cd1f 1fdb5575f 1051fff1a 17524cdf9 174e4cd9a 17548cf93 105a089fa \
                     1fd10cd23";
        for (text, rows) in [("A", small), (address, large)] {
            let modules = qr(text).unwrap();
            let found: Vec<String> = modules
                .iter()
                .map(|row| format!("{:x}", row.iter().fold(0_u64, |sum, module| sum << 1 | u64::from(*module))))
                .collect();
            let rows: Vec<&str> = rows.split_whitespace().collect();
            assert_eq!(found, rows);
        }
        assert_eq!(qr(&"x".repeat(106)).unwrap().len(), 37);
        assert!(qr(&"x".repeat(107)).is_none());
        assert_eq!(qr_text(&qr("A").unwrap()).lines().count(), 13);
    }
}
