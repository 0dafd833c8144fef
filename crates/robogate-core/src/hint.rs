//! Suggestions for unknown names.

/// The hint of an error about an unknown name: the nearest known name, or all of them.
pub fn hint<'a>(word: &str, known: impl Iterator<Item = &'a str> + Clone) -> String {
    let near = known
        .clone()
        .map(|candidate| {
            let extends = !word.is_empty() && (candidate.starts_with(word) || word.starts_with(candidate));
            (if extends { 1 } else { distance(word, candidate) }, candidate)
        })
        .min_by_key(|(distance, _)| *distance);
    match near {
        Some((distance, candidate)) if distance <= 1 + word.len() / 4 => format!("did you mean `{candidate}`?"),
        _ => format!("expected one of: {}", known.collect::<Vec<_>>().join(", ")),
    }
}

/// Levenshtein distance over bytes: the number of insertions, deletions and substitutions.
fn distance(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.bytes().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.bytes().enumerate() {
            let changed = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = changed.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hint_names_nearest_word_or_all() {
        let known = ["friction", "mass_kg", "size_m"];
        assert_eq!(hint("fricton", known.into_iter()), "did you mean `friction`?");
        assert_eq!(hint("mass", known.into_iter()), "did you mean `mass_kg`?");
        assert_eq!(hint("temperature", known.into_iter()), "expected one of: friction, mass_kg, size_m");
    }

    #[test]
    fn distance_counts_single_edits() {
        for (a, b, d) in [("", "abc", 3), ("kitten", "sitting", 3), ("same", "same", 0), ("ab", "ba", 2)] {
            assert_eq!((distance(a, b), distance(b, a)), (d, d), "{a} {b}");
        }
    }
}
