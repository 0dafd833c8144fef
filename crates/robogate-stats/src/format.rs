//! Formats numbers for people. All rounding of displayed figures happens here.
//!
//! Every function gives the same text on every machine. A minus sign is U+2212, a missing figure is "-", and a value
//! that rounds to zero has no sign.

/// A number with three significant digits.
pub fn number(x: f64) -> String {
    significant(x, 3)
}

/// A number with `digits` significant digits. Integers below a million keep all digits. Exponents are used below 1e-5
/// and from 1e6 on.
pub fn significant(x: f64, digits: i32) -> String {
    if !x.is_finite() {
        return "-".to_owned();
    }
    let size = x.abs();
    if size <= 0.0 {
        return "0".to_owned();
    }
    let exponent = size.log10().floor() as i32;
    if !(-5..6).contains(&exponent) {
        return minus(format!("{x:.*e}", (digits - 1).max(0) as usize));
    }
    let text = format!("{x:.*}", (digits - 1 - exponent).max(0) as usize);
    // Trailing zeros are removed: 0.0500 becomes 0.05, because the interval already shows the precision.
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text };
    minus(text)
}

/// A number with a fixed number of decimals.
pub fn fixed(x: f64, decimals: usize) -> String {
    if x.is_finite() { minus(format!("{x:.decimals$}")) } else { "-".to_owned() }
}

fn minus(text: String) -> String {
    let zero = text.trim_start_matches('-').chars().all(|c| matches!(c, '0' | '.'));
    match text.strip_prefix('-') {
        Some(rest) if zero => rest.to_owned(),
        Some(rest) => format!("\u{2212}{rest}"),
        None => text,
    }
}

/// A range of numbers: "0.1 to 2".
pub fn range([low, high]: [f64; 2]) -> String {
    format!("{} to {}", number(low), number(high))
}

/// A fraction as a percentage with one decimal: "29.3 %".
pub fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

/// A fraction as a percentage, or "-" if it is missing.
pub fn percent_or_dash(share: Option<f64>) -> String {
    share.map_or_else(|| "-".to_owned(), percent)
}

/// A range of fractions: "21.0 to 38.9 %".
pub fn percent_range([low, high]: [f64; 2]) -> String {
    format!("{:.1} to {:.1} %", 100.0 * low, 100.0 * high)
}

/// A difference of fractions in percentage points, with its sign: "+3.1".
pub fn points(difference: f64) -> String {
    let text = fixed(100.0 * difference, 1);
    if difference > 0.0 && text != "0.0" { format!("+{text}") } else { text }
}

/// A range of differences in percentage points.
pub fn points_range([low, high]: [f64; 2]) -> String {
    format!("{} to {}", points(low), points(high))
}

/// A count with thousands separators: "12,345".
pub fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// A count with its noun: "1 row", "2 rows".
pub fn counted(n: u64, thing: &str) -> String {
    if n == 1 { format!("1 {thing}") } else { format!("{} {thing}s", count(n)) }
}

/// Smaller p-values are stated as a bound: no approximation is accurate so far in the tail.
const LEAST_P: f64 = 1e-6;

/// A p-value from its natural logarithm. Below 1e-6 it is a bound, `< 1e-6`.
pub fn p_value(ln_p: f64) -> String {
    let p = ln_p.exp();
    if p >= 0.001 {
        fixed(p, 3)
    } else if p >= LEAST_P {
        let exponent = (ln_p / std::f64::consts::LN_10).floor();
        let mantissa = (ln_p - exponent * std::f64::consts::LN_10).exp();
        format!("{mantissa:.1}e{}", minus(format!("{exponent:.0}")))
    } else {
        "< 1e\u{2212}6".to_owned()
    }
}

/// A p-value as an equation: `p = 0.037`, or `p < 1e-6`.
pub fn p_equation(ln_p: f64) -> String {
    let p = p_value(ln_p);
    if p.starts_with('<') { format!("p {p}") } else { format!("p = {p}") }
}

/// Items as a list in a sentence: "a, b and c".
pub fn list(items: &[String]) -> String {
    match items {
        [] => String::new(),
        [one] => one.clone(),
        [rest @ .., last] => format!("{} and {last}", rest.join(", ")),
    }
}

/// A text with its first letter in upper case.
pub fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Whether a character can hide or reorder the text around it: control characters, line and paragraph separators, and
/// the controls of Unicode's bidirectional algorithm (UAX #9). A name with the latter can show `pass` where its bytes say
/// something else.
#[must_use]
pub fn is_deceptive(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// The date in UTC of a time in seconds since 1970: "2026-11-27". Source: Howard Hinnant, "chrono-Compatible Low-Level Date
/// Algorithms".
pub fn date(unix_s: u64) -> String {
    let days = unix_s / 86_400 + 719_468;
    let (era, of_era) = (days / 146_097, days % 146_097);
    let year = (of_era - of_era / 1_460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let (month, later) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    format!("{:04}-{month:02}-{day:02}", year + 400 * era + later)
}

/// Date and time of day in UTC of a time in seconds since 1970: "2026-11-27 19:46".
pub fn date_and_time(unix_s: u64) -> String {
    let of_day = unix_s % 86_400;
    format!("{} {:02}:{:02}", date(unix_s), of_day / 3600, of_day / 60 % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_follow_the_calendar() {
        // As `date -u -d @SECONDS` prints them.
        for (seconds, expected) in [
            (0, "1970-01-01 00:00"),
            (951_782_399, "2000-02-28 23:59"),
            (951_782_400, "2000-02-29 00:00"),
            (1_709_251_199, "2024-02-29 23:59"),
            (1_796_000_000, "2026-11-30 00:53"),
            (4_107_542_400, "2100-03-01 00:00"),
        ] {
            assert_eq!(date_and_time(seconds), expected);
        }
    }

    #[test]
    fn reordering_characters_are_deceptive() {
        for c in ['\u{1b}', '\u{9b}', '\u{7f}', '\u{202e}', '\u{2066}', '\u{2069}', '\u{200f}', '\u{2028}'] {
            assert!(is_deceptive(c), "{c:?}");
        }
        // Letters of languages written from right to left, and combined emoji, stay.
        assert!(!"a \u{e4}\u{5d0}\u{627}\u{1f468}\u{200d}\u{1f469}\u{b7}\u{2013}".contains(is_deceptive));
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(number(0.4923), "0.492");
        assert_eq!(number(1.5), "1.5");
        assert_eq!(number(-0.25), "\u{2212}0.25");
        assert_eq!(number(12_345.6), "12346");
        assert_eq!(number(1e-9), "1.00e-9");
        assert_eq!(number(f64::NAN), "-");
    }

    #[test]
    fn zero_has_no_sign() {
        assert_eq!(number(-0.0), "0");
        assert_eq!(fixed(-0.001, 2), "0.00");
        assert_eq!(points(0.000_1), "0.0");
    }

    #[test]
    fn tiny_p_values_stay_readable() {
        assert_eq!(p_value(0.037_f64.ln()), "0.037");
        assert_eq!(p_value(2.5e-6_f64.ln()), "2.5e\u{2212}6");
        for ln_p in [9e-7_f64.ln(), -2000.0 * std::f64::consts::LN_10, f64::NEG_INFINITY] {
            assert_eq!(p_value(ln_p), "< 1e\u{2212}6");
            assert_eq!(p_equation(ln_p), "p < 1e\u{2212}6");
        }
        assert_eq!(p_equation(0.037_f64.ln()), "p = 0.037");
    }

    #[test]
    fn thousands_are_separated() {
        for (n, text) in [(0, "0"), (999, "999"), (20_000, "20,000"), (1_234_567, "1,234,567")] {
            assert_eq!(count(n), text);
        }
    }

    #[test]
    fn lists_end_with_and() {
        let items = ["a", "b", "c"].map(str::to_owned);
        assert_eq!((list(&items), list(&items[..1]), list(&[])), ("a, b and c".into(), "a".into(), String::new()));
    }
}
