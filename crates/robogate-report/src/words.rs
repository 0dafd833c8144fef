//! How figures and names are written.

use robogate_stats::Interval;

/// A number with three significant digits, without an exponent where it can be read without one.
pub(crate) fn number(x: f64) -> String {
    significant(x, 3)
}

/// A number with this many significant digits; whole numbers below a million keep all of theirs.
pub(crate) fn significant(x: f64, digits: i32) -> String {
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
    // 0.0500 says no more than 0.05 here: the interval beside it tells the precision.
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text };
    minus(text)
}

/// A number with this many decimals.
pub(crate) fn fixed(x: f64, decimals: usize) -> String {
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

/// A share as a percentage with one decimal.
pub(crate) fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

/// A share that may be missing.
pub(crate) fn percent_or_dash(share: Option<f64>) -> String {
    share.map_or_else(|| "-".to_owned(), percent)
}

/// An interval of shares.
pub(crate) fn percents([low, high]: [f64; 2]) -> String {
    format!("{:.1} to {:.1} %", 100.0 * low, 100.0 * high)
}

/// An interval of numbers.
pub(crate) fn range([low, high]: [f64; 2]) -> String {
    format!("{} to {}", number(low), number(high))
}

/// A difference of shares in percentage points, with its sign.
pub(crate) fn points(share: f64) -> String {
    let text = fixed(100.0 * share, 1);
    if share > 0.0 && text != "0.0" { format!("+{text}") } else { text }
}

/// An interval of differences in percentage points.
pub(crate) fn points_range([low, high]: [f64; 2]) -> String {
    format!("{} to {}", points(low), points(high))
}

/// A count with groups of thousands: 12,345.
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

/// A p-value from its logarithm, readable however small it is.
pub(crate) fn p_value(ln_p: f64) -> String {
    let p = ln_p.exp();
    if p >= 0.001 {
        fixed(p, 3)
    } else if ln_p.is_finite() {
        let exponent = (ln_p / std::f64::consts::LN_10).floor();
        let mantissa = (ln_p - exponent * std::f64::consts::LN_10).exp();
        format!("{mantissa:.1}e{}", minus(format!("{exponent:.0}")))
    } else {
        "0".to_owned()
    }
}

/// The ends of an interval.
pub(crate) fn ends(interval: Interval) -> [f64; 2] {
    [interval.low, interval.high]
}

/// Units that a parameter's name may end in, and how they are written.
const UNITS: [(&str, &str); 10] = [
    ("_m_s2", "m/s²"),
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_kg", "kg"),
    ("_mm", "mm"),
    ("_rad", "rad"),
    ("_deg", "°"),
    ("_m", "m"),
    ("_n", "N"),
    ("_s", "s"),
];

/// A parameter's name without its unit, as people write it, and the unit.
pub(crate) fn label(name: &str) -> (String, &'static str) {
    let (stem, unit) = UNITS
        .iter()
        .find_map(|(ending, unit)| name.strip_suffix(ending).filter(|stem| !stem.is_empty()).map(|stem| (stem, *unit)))
        .unwrap_or((name, ""));
    let words: Vec<String> = stem
        .split('_')
        .map(|word| match word {
            "ik" | "com" => word.to_ascii_uppercase(),
            _ => word.to_owned(),
        })
        .collect();
    (words.join(" "), unit)
}

/// A parameter's name as people write it.
pub(crate) fn name(parameter: &str) -> String {
    label(parameter).0
}

/// The same with its unit in brackets.
pub(crate) fn name_with_unit(parameter: &str) -> String {
    match label(parameter) {
        (name, "") => name,
        (name, unit) => format!("{name} ({unit})"),
    }
}

/// A value with the unit of its parameter.
pub(crate) fn with_unit(value: &str, parameter: &str) -> String {
    match label(parameter).1 {
        "" => value.to_owned(),
        unit => format!("{value} {unit}"),
    }
}

/// A failure mode as people write it.
pub(crate) fn mode(word: &str) -> String {
    word.replace('_', " ")
}

/// A text with its first letter large.
pub(crate) fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// Words as a list in a sentence.
pub(crate) fn listed(words: &[String]) -> String {
    match words {
        [] => String::new(),
        [one] => one.clone(),
        [rest @ .., last] => format!("{} and {last}", rest.join(", ")),
    }
}

/// A number of things: `1 row`, `2 rows`.
pub(crate) fn counted(n: u64, thing: &str) -> String {
    if n == 1 { format!("1 {thing}") } else { format!("{} {thing}s", count(n)) }
}

/// A path as a shell takes it for one word.
pub(crate) fn quoted(path: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || matches!(c, '/' | '\\' | ':' | '.' | '_' | '-');
    if !path.is_empty() && path.chars().all(plain) {
        path.to_owned()
    } else {
        format!("'{}'", path.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_never_minus_zero() {
        assert_eq!(number(0.4923), "0.492");
        assert_eq!(number(1.5), "1.5");
        assert_eq!(number(-0.0), "0");
        assert_eq!(number(-0.25), "\u{2212}0.25");
        assert_eq!(number(12_345.6), "12346");
        assert_eq!(number(1e-9), "1.00e-9");
        assert_eq!(fixed(-0.001, 2), "0.00");
        assert_eq!(number(f64::NAN), "-");
    }

    #[test]
    fn p_values_are_readable_far_below_the_smallest_double() {
        assert_eq!(p_value(0.037_f64.ln()), "0.037");
        assert_eq!(p_value(-2000.0 * std::f64::consts::LN_10), "1.0e\u{2212}2000");
    }

    #[test]
    fn names_lose_their_units() {
        assert_eq!(label("mass_kg"), ("mass".to_owned(), "kg"));
        assert_eq!(label("ik_noise_rad"), ("IK noise".to_owned(), "rad"));
        assert_eq!(label("friction"), ("friction".to_owned(), ""));
        assert_eq!(label("m"), ("m".to_owned(), ""));
    }

    #[test]
    fn thousands_are_grouped() {
        for (n, text) in [(0, "0"), (999, "999"), (20_000, "20,000"), (1_234_567, "1,234,567")] {
            assert_eq!(count(n), text);
        }
    }
}
