//! Numbers as spreadsheets write them in other countries: `0,5`, `1.234,5`, `1,234.5`, `1 234`.
//!
//! `1,234` alone can be 1.234 or 1234. The other numbers of the file decide. If they do not, the file is refused.

use crate::raw::Scalar;

/// How a number with separators can be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shape {
    /// One separator, before a fraction: `0,5`.
    Decimal(char),
    /// One separator, before a fraction or before thousands: `1,234`.
    Either(char),
    /// Separators between groups of digits: `1,234,567`.
    Grouped(char),
    /// Groups and a fraction: `1,234.5`.
    Both { group: char, decimal: char },
}

/// The characters that separate thousands, other than comma and point.
const SPACES: [char; 5] = [' ', '\u{A0}', '\u{202F}', '\'', '\u{2019}'];

fn shape(text: &str) -> Option<Shape> {
    let text = text.strip_prefix(['-', '+', '\u{2212}']).unwrap_or(text);
    let (body, exponent) = match text.split_once(['e', 'E']) {
        Some((body, exponent)) => (body, exponent.parse::<i32>().is_ok().then_some(true)?),
        None => (text, false),
    };
    let separator = |c: char| matches!(c, '.' | ',') || SPACES.contains(&c);
    let separators: Vec<char> = body.chars().filter(|c| !c.is_ascii_digit()).collect();
    if separators.is_empty() || !separators.iter().all(|c| separator(*c)) {
        return None;
    }
    let groups: Vec<&str> = body.split(separator).collect();
    let (first, last) = (*groups.first()?, *groups.last()?);
    if last.is_empty() || groups[1..].iter().any(|group| group.is_empty()) {
        return None;
    }
    let (&end, start) = separators.split_last()?;
    let thousands = |groups: &[&str], by: char| {
        let leads = (1..=3).contains(&groups[0].len()) && !groups[0].starts_with('0');
        let (&tail, middle) = groups[1..].split_last().unwrap_or((&"", &[]));
        let european = middle.iter().all(|group| group.len() == 3);
        // Groups of two digits before the last three are Indian.
        let indian = by == ',' && groups[0].len() <= 2 && !middle.is_empty() && middle.iter().all(|g| g.len() == 2);
        leads && tail.len() == 3 && (european || indian)
    };
    let is_decimal = matches!(end, '.' | ',');
    match start.first() {
        None if is_decimal && !exponent && thousands(&groups, end) => Some(Shape::Either(end)),
        None if is_decimal => Some(Shape::Decimal(end)),
        _ if first.is_empty() || exponent && !is_decimal => None,
        None => thousands(&groups, end).then_some(Shape::Grouped(end)),
        Some(&group) if !start.iter().all(|c| *c == group) => None,
        Some(&group) if group == end => (!exponent && thousands(&groups, group)).then_some(Shape::Grouped(group)),
        Some(&group) => {
            (is_decimal && thousands(&groups[..groups.len() - 1], group)).then_some(Shape::Both { group, decimal: end })
        }
    }
}

/// Where a number was seen: its line and its text.
type Seen = Option<(u64, String)>;

/// What the numbers of a file say about its separators. Each place is that of the first such number.
#[derive(Debug, Default)]
pub(super) struct Evidence {
    /// The comma starts a fraction.
    comma_decimal: Seen,
    /// The comma separates thousands, or the point starts a fraction.
    point_decimal: Seen,
    /// The point separates thousands.
    point_groups: Seen,
    comma_either: Seen,
    point_either: Seen,
}

impl Evidence {
    pub(super) fn take(&mut self, line: u64, text: &str) {
        let text = text.trim();
        // The first character rules out most fields.
        if !text.contains([',', '.']) || !text.starts_with(|c: char| c.is_ascii_digit() || "-+\u{2212},.".contains(c)) {
            return;
        }
        let place = match shape(text) {
            Some(Shape::Decimal(',') | Shape::Both { decimal: ',', .. }) => &mut self.comma_decimal,
            Some(Shape::Grouped(',') | Shape::Decimal('.') | Shape::Both { decimal: '.', .. }) => {
                &mut self.point_decimal
            }
            Some(Shape::Either(',')) => &mut self.comma_either,
            Some(Shape::Either('.')) => &mut self.point_either,
            _ => return,
        };
        place.get_or_insert_with(|| (line, text.to_owned()));
        if let Some(Shape::Both { group: '.', .. }) = shape(text) {
            self.point_groups.get_or_insert_with(|| (line, text.to_owned()));
        }
    }

    /// Whether a field is a number, with whatever separators.
    pub(super) fn may_be_number(text: &str) -> bool {
        shape(text).is_some() || plain(text).is_some()
    }

    /// How the file writes numbers, or why that cannot be known.
    pub(super) fn decide(self) -> Result<Numbers, String> {
        const HINT: &str = "Hint: write every number with a decimal point and without thousands separators";
        let either = |(line, text): (u64, String), what: &str| {
            Err(format!("line {line}: `{text}` is ambiguous: {what}\n{HINT}"))
        };
        match self {
            Self { comma_decimal: Some((a, comma)), point_decimal: Some((b, point)), .. } => Err(format!(
                "line {a} has `{comma}`, where the comma is a decimal sign, and line {b} has `{point}`, where it is not\n{HINT}"
            )),
            Self { comma_decimal: Some(_), point_either: Some(seen), point_groups: None, .. } => {
                either(seen, "the point can be a decimal sign or separate thousands, in a file with decimal commas")
            }
            Self { comma_decimal: Some(_), .. } => Ok(Numbers { decimal: ',' }),
            // A point that separates one group only: in a file with a comma that separates thousands it is decimal.
            Self { comma_either: Some(seen), point_decimal: None, .. } => {
                either(seen, "the comma can be a decimal sign or separate thousands")
            }
            _ => Ok(Numbers { decimal: '.' }),
        }
    }
}

/// How a file writes numbers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Numbers {
    decimal: char,
}

impl Numbers {
    /// The number in a field, if the field is one.
    pub(super) fn read(self, text: &str) -> Option<Scalar> {
        let shape =
            text.contains([',', '.', ' ', '\u{A0}', '\u{202F}', '\'', '\u{2019}']).then(|| shape(text)).flatten();
        let decimal = match shape {
            None => return plain(text),
            Some(Shape::Decimal(sign) | Shape::Both { decimal: sign, .. }) if sign == self.decimal => true,
            Some(Shape::Either(sign)) => sign == self.decimal,
            Some(Shape::Grouped(sign)) if sign != self.decimal => false,
            Some(_) => return None,
        };
        let keep = |c: &char| c.is_ascii_alphanumeric() || matches!(c, '+' | '-') || (decimal && *c == self.decimal);
        let minus = |c| if c == '\u{2212}' { '-' } else { c };
        let digits: String = text.chars().map(minus).filter(keep).map(|c| if c == ',' { '.' } else { c }).collect();
        plain(&digits)
    }
}

/// A number without separators. An integer that needs more than 64 bits stays a text, so that no digit is lost.
fn plain(text: &str) -> Option<Scalar> {
    if let Ok(n) = text.parse() {
        return Some(Scalar::Integer(n));
    }
    if let Ok(n) = text.parse() {
        return Some(Scalar::Unsigned(n));
    }
    let digits = text.strip_prefix(['-', '+']).unwrap_or(text);
    if digits.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    // A parameter cannot be infinite.
    text.parse().ok().filter(|x: &f64| x.is_finite()).map(Scalar::Number)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(fields: &[&str]) -> Result<Vec<Option<Scalar>>, String> {
        let mut evidence = Evidence::default();
        (1..).zip(fields).for_each(|(line, field)| evidence.take(line, field));
        evidence.decide().map(|numbers| fields.iter().map(|field| numbers.read(field)).collect())
    }

    fn numbers(fields: &[&str]) -> Vec<f64> {
        let number = |scalar: Option<Scalar>| match scalar {
            Some(Scalar::Number(x)) => x,
            Some(Scalar::Integer(n)) => n as f64,
            other => panic!("{other:?}"),
        };
        read(fields).unwrap().into_iter().map(number).collect()
    }

    #[test]
    fn other_numbers_of_file_decide() {
        assert_eq!(numbers(&["0,5", "1,234", "-2,5E-3", "7"]), [0.5, 1.234, -0.0025, 7.0]);
        assert_eq!(numbers(&["1.234,5", "1.234", "2,000"]), [1234.5, 1234.0, 2.0]);
        assert_eq!(numbers(&["1,234.5", "1,234", "0.25"]), [1234.5, 1234.0, 0.25]);
        assert_eq!(numbers(&["1,234,567", "1,234", "1,00,000"]), [1_234_567.0, 1234.0, 100_000.0]);
        assert_eq!(numbers(&["1.234", "0.5", "12.345"]), [1.234, 0.5, 12.345]);
        assert_eq!(numbers(&["1\u{202F}234,5", "\u{2212}3,25", "1 234"]), [1234.5, -3.25, 1234.0]);
        assert_eq!(numbers(&["1'234.5", "1'234'567"]), [1234.5, 1_234_567.0]);
    }

    #[test]
    fn ambiguous_numbers_are_refused() {
        for (fields, wanted) in [
            (&["x", "1,234", "12,500"][..], "line 2: `1,234` is ambiguous"),
            (&["0,5", "1.234"], "line 2: `1.234` is ambiguous"),
            (&["0,5", "0.5"], "line 1 has `0,5`, where the comma is a decimal sign, and line 2 has `0.5`"),
        ] {
            let error = read(fields).unwrap_err();
            assert!(error.starts_with(wanted), "{error}");
        }
    }

    #[test]
    fn words_stay_words() {
        for word in
            ["1,2,3", "192.168.0.1", "1.2.3", "a,5", ",", "5,", "01.02.2026", "340282366920938463463374607431768211456"]
        {
            assert_eq!(read(&[word]).unwrap(), [None], "{word}");
        }
    }
}
