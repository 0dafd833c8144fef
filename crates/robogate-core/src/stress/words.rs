//! Other words for a task.

use crate::Stream;

/// The text, in which this share of the letters is exchanged with the letter after it.
pub(super) fn with_typos(text: &str, share: f64, stream: &mut Stream) -> String {
    let mut letters: Vec<char> = text.chars().collect();
    let mut at = 0;
    while at + 1 < letters.len() {
        let both = letters[at].is_alphabetic() && letters[at + 1].is_alphabetic();
        if both && stream.uniform() < share {
            letters.swap(at, at + 1);
            // The same letter does not move on.
            at += 1;
        }
        at += 1;
    }
    letters.into_iter().collect()
}

/// The text in another case: 0 as it is, 1 small, 2 capital letters.
pub(super) fn in_case(text: &str, case: i64) -> String {
    match case {
        1 => text.to_lowercase(),
        2 => text.to_uppercase(),
        _ => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Seed;

    #[test]
    fn typos_keep_letters_and_words() {
        let text = "Pick up the red cube, then let go";
        let mut stream = Seed::campaign(1).stream("t");
        assert_eq!(with_typos(text, 0.0, &mut stream), text);
        let wrong = with_typos(text, 1.0, &mut stream);
        assert_ne!(wrong, text);
        let sorted = |word: &str| {
            let mut letters: Vec<char> = word.chars().collect();
            letters.sort_unstable();
            letters
        };
        let words = |text: &str| text.split(' ').map(sorted).collect::<Vec<_>>();
        assert_eq!(words(&wrong), words(text));
        assert_eq!((in_case(text, 1), in_case("ä", 2)), (text.to_lowercase(), "Ä".to_owned()));
    }
}
