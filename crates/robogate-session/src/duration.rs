//! Durations on the command line.

use std::time::Duration;

/// The units of durations, in seconds.
const UNITS: [(&str, f64); 4] = [("ms", 1e-3), ("s", 1.0), ("m", 60.0), ("h", 3600.0)];

/// Parses a duration such as `80ms`, `1.5s`, `10m` or `2h`, in seconds.
pub fn seconds(text: &str) -> Result<f64, String> {
    let text = text.trim();
    let digits = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let number: Option<f64> = number.trim().parse().ok().filter(|n: &f64| n.is_finite() && *n >= 0.0);
    let unit = UNITS.iter().find(|(name, _)| *name == unit);
    match (number, unit) {
        (Some(number), Some((_, unit))) => Ok(number * unit),
        _ => Err(format!("`{text}` is not a valid duration. Expected a number with a unit: 80ms, 1.5s, 10m or 2h")),
    }
}

/// Parses a duration, at most a day.
pub fn parse(text: &str) -> Result<Duration, String> {
    const DAY_S: f64 = 86_400.0;
    let seconds = seconds(text)?;
    if seconds > DAY_S {
        return Err(format!("{text} is out of range. Expected at most 24h"));
    }
    Ok(Duration::from_secs_f64(seconds))
}

/// Formats a duration to a second: `8 s`, `2 min 5 s`, `1 h 3 min`.
pub fn in_words(duration: Duration) -> String {
    match duration.as_secs() {
        s @ 0..60 => format!("{s} s"),
        s @ 60..3600 => format!("{} min {} s", s / 60, s % 60),
        s => format!("{} h {} min", s / 3600, s % 3600 / 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_short() {
        for (s, text) in [(0, "0 s"), (59, "59 s"), (125, "2 min 5 s"), (3780, "1 h 3 min")] {
            assert_eq!(in_words(Duration::from_secs(s)), text);
        }
    }

    #[test]
    fn durations_need_units() {
        let close = |text: &str, expected: f64| assert!((seconds(text).unwrap() - expected).abs() < 1e-12, "{text}");
        for (text, s) in [("80ms", 0.08), ("1.5s", 1.5), ("10m", 600.0), ("2h", 7200.0), ("0s", 0.0)] {
            close(text, s);
        }
        for wrong in ["", "10", "-1s", "1d", "s", "nan s", "1e999s"] {
            assert!(seconds(wrong).is_err(), "{wrong}");
        }
        assert!(parse("25h").is_err());
    }
}
