//! Deployed policies with one mutation each, and those that only compute in another way.

use serde_json::{Value as Json, json};

use super::*;
use crate::array::{Array, Dtype};

const PIXELS: usize = 8;
const ROWS: usize = 6;
const SIZE: usize = 7;

/// Reproducible numbers in (-1, 1).
fn numbers(seed: u64, n: usize) -> Vec<f64> {
    let mut stream = robogate_core::Seed::campaign(seed).stream("test");
    (0..n).map(|_| stream.between(-1.0, 1.0)).collect()
}

fn query(seed: u64) -> Query {
    let image = |which: u64| {
        let data = numbers(seed * 10 + which, 3 * PIXELS * PIXELS).iter().map(|x| (127.0 + 120.0 * x) as u8).collect();
        Array::new(Dtype::U8, vec![PIXELS, PIXELS, 3], data).unwrap()
    };
    let state = |which: u64, n: usize| Array::vector(&numbers(seed * 10 + which, n), Dtype::F32);
    Query {
        images: vec![("front".into(), image(1)), ("wrist".into(), image(2))],
        states: vec![("joints".into(), state(3, 6)), ("pose".into(), state(4, 7)), ("gripper".into(), state(5, 1))],
        instruction: "pick up the part".into(),
        step: seed,
        time_s: 0.0,
    }
}

/// The judged policy: a smooth function of all of its inputs, scaled to the ranges of its actions.
fn answer(query: &Query, weights: u64) -> Vec<Vec<f64>> {
    let mut inputs: Vec<f64> = Vec::new();
    for (_, image) in &query.images {
        inputs.extend(image.data().iter().map(|byte| f64::from(*byte) / 255.0 - 0.5));
    }
    query.states.iter().for_each(|(_, state)| inputs.extend(state.numbers()));
    let prompt = query.instruction.bytes().map(f64::from).sum::<f64>() / 2000.0;
    inputs.push(prompt);
    let weights = numbers(weights, 64);
    let row = |t: usize| {
        let number = |j: usize| {
            let sum: f64 =
                inputs.iter().enumerate().map(|(i, x)| x * weights[(7 * i + 11 * j + 3 * t + i / 9) % 64]).sum();
            (0.4 * sum).sin() * if j == 6 { 1.0 } else { 0.05 * (1 + j) as f64 }
        };
        (0..SIZE).map(number).collect()
    };
    (0..ROWS).map(row).collect()
}

/// A policy that changes its request before it answers, and its answer after it.
struct Deployed<'a> {
    before: &'a dyn Fn(&mut Query),
    after: &'a dyn Fn(&mut Vec<Vec<f64>>),
    weights: u64,
    declared: Json,
}

impl Deployed<'_> {
    fn plain() -> Self {
        Self { before: &|_| {}, after: &|_| {}, weights: 1, declared: json!({ "model": "m" }) }
    }
}

impl Asked for Deployed<'_> {
    fn ask(&mut self, query: &Query) -> Result<Chunk, PolicyError> {
        let mut query = query.clone();
        (self.before)(&mut query);
        let mut rows = answer(&query, self.weights);
        (self.after)(&mut rows);
        Chunk::of_rows(rows)
    }

    fn declared(&self) -> &Json {
        &self.declared
    }
}

fn judged() -> Fingerprint {
    let profile = Profile::from_toml(Profile::built_in("pi0-libero").unwrap()).unwrap();
    let queries = (0..20).map(query).collect();
    Fingerprint::measure(queries, &mut Deployed::plain(), &profile, 0.05).unwrap()
}

/// The number with the eleven significant bits of half precision.
fn half(x: f64) -> f64 {
    f64::from_bits((x.to_bits() + (1 << 41)) & !((1 << 42) - 1))
}

fn state(query: &mut Query, at: usize, change: impl Fn(&mut Vec<f64>)) {
    let mut values = query.states[at].1.numbers();
    change(&mut values);
    query.states[at].1 = Array::vector(&values, Dtype::F32);
}

fn pixels(query: &mut Query, which: &[usize], source: impl Fn([usize; 3]) -> [usize; 3]) {
    for at in which {
        let old = query.images[*at].1.data().to_vec();
        let place = |[y, x, c]: [usize; 3]| (y * PIXELS + x) * 3 + c;
        let all = (0..PIXELS).flat_map(|y| (0..PIXELS).flat_map(move |x| (0..3).map(move |c| [y, x, c])));
        let mut new = old.clone();
        all.for_each(|to| new[place(to)] = old[place(source(to))]);
        query.images[*at].1 = Array::new(Dtype::U8, vec![PIXELS, PIXELS, 3], new).unwrap();
    }
}

#[test]
fn every_mutation_is_refused_and_most_causes_are_named() {
    type Before<'a> = &'a dyn Fn(&mut Query);
    let requests: [(&str, Before<'_>); 14] = [
        ("images arrive mirrored", &|q| pixels(q, &[0, 1], |[y, x, c]| [y, PIXELS - 1 - x, c])),
        ("`wrist` arrives mirrored", &|q| pixels(q, &[1], |[y, x, c]| [y, PIXELS - 1 - x, c])),
        ("rotated by 180", &|q| pixels(q, &[0, 1], |[y, x, c]| [PIXELS - 1 - y, PIXELS - 1 - x, c])),
        ("BGR", &|q| pixels(q, &[0, 1], |[y, x, c]| [y, x, 2 - c])),
        ("`front` and `wrist` are exchanged", &|q| {
            let kept = q.images[0].1.clone();
            q.images[0].1 = q.images[1].1.clone();
            q.images[1].1 = kept;
        }),
        ("`joints` arrives in degrees", &|q| state(q, 0, |v| v.iter_mut().for_each(|x| *x *= 57.29577951308232))),
        ("number 3 of the state `pose` arrives with the opposite sign", &|q| state(q, 1, |v| v[2] = -v[2])),
        ("reverse order", &|q| state(q, 0, |v| v.reverse())),
        ("scalar first", &|q| state(q, 1, |v| v[3..7].rotate_right(1))),
        ("`gripper` arrives as one minus", &|q| state(q, 2, |v| v[0] = 1.0 - v[0])),
        ("millimetres", &|q| state(q, 1, |v| v.iter_mut().for_each(|x| *x *= 1000.0))),
        ("`instruction` has no effect", &|q| q.instruction = "another task".into()),
        ("`front` has no effect", &|q| {
            q.images[0].1 = Array::new(Dtype::U8, vec![PIXELS, PIXELS, 3], vec![90; 3 * PIXELS * PIXELS]).unwrap();
        }),
        ("`joints` has no effect", &|q| state(q, 0, |v| v.fill(0.0))),
    ];
    type After<'a> = &'a dyn Fn(&mut Vec<Vec<f64>>);
    let answers: [(&str, After<'_>); 12] = [
        ("7 numbers of the action are 0.9500 times", &|rows| rows.iter_mut().flatten().for_each(|x| *x *= 0.95)),
        ("the gripper's number has the opposite sign", &|rows| rows.iter_mut().for_each(|row| row[6] = -row[6])),
        ("one minus", &|rows| rows.iter_mut().for_each(|row| row[6] = 1.0 - row[6])),
        ("number 4 of the action is in degrees", &|rows| rows.iter_mut().for_each(|row| row[3] *= 57.29577951308232)),
        ("number 2 of the action is 2.500 times", &|rows| rows.iter_mut().for_each(|row| row[1] *= 2.5)),
        ("another order", &|rows| rows.iter_mut().for_each(|row| row.swap(0, 1))),
        ("normaliser", &|rows| {
            for row in rows {
                row.iter_mut().enumerate().for_each(|(j, x)| *x = *x * (1.2 + 0.1 * j as f64) + 0.01 * (j + 1) as f64);
            }
        }),
        ("2 actions in place of 6", &|rows| rows.truncate(2)),
        ("begin 1 later", &|rows| {
            rows.remove(0);
            let last = rows[rows.len() - 1].clone();
            rows.push(last);
        }),
        ("lower precision", &|rows| rows.iter_mut().flatten().for_each(|x| *x = half(*x))),
        ("do not depend on the request", &|rows| rows.iter_mut().flatten().for_each(|x| *x = 0.3)),
        ("6 numbers in place of 7", &|rows| rows.iter_mut().for_each(|row| row.truncate(6))),
    ];
    let judged = judged();
    assert_eq!(judged.used, ["front", "wrist", "joints", "pose", "gripper", "instruction"]);
    let mut unnamed = Vec::new();
    let mut check = |cause: &str, deployed: &mut Deployed<'_>| {
        let found = admit(&judged, deployed).unwrap();
        assert!(!found.is_admitted(), "{cause}");
        if !found.differences.iter().any(|difference| difference.contains(cause)) {
            unnamed.push((cause.to_owned(), found.differences));
        }
    };
    for (cause, before) in requests {
        check(cause, &mut Deployed { before, ..Deployed::plain() });
    }
    for (cause, after) in answers {
        check(cause, &mut Deployed { after, ..Deployed::plain() });
    }
    check("other weights", &mut Deployed { weights: 2, ..Deployed::plain() });
    check("model = \"n\"", &mut Deployed { declared: json!({ "model": "n" }), ..Deployed::plain() });
    assert!(unnamed.is_empty(), "{unnamed:#?}");
}

#[test]
fn other_arithmetic_is_admitted() {
    let judged = judged();
    let single = |rows: &mut Vec<Vec<f64>>| rows.iter_mut().flatten().for_each(|x| *x = f64::from(*x as f32));
    let mut deployed = Deployed { after: &single, ..Deployed::plain() };
    let found = admit(&judged, &mut deployed).unwrap();
    assert_eq!((found.differences.as_slice(), found.requests), (&[][..], 20));
    // Another export of the same network has other bytes.
    let mut exported = Deployed { declared: json!({ "model": "m", "sha256": "00" }), ..Deployed::plain() };
    assert!(admit(&judged, &mut exported).unwrap().is_admitted());
}

/// A policy whose answers have noise: the same distribution is admitted, another one is not.
#[test]
fn answers_that_are_not_numbers_are_refused_without_a_cause() {
    let fingerprint = judged();
    for share in [1, 2] {
        let broken = |rows: &mut Vec<Vec<f64>>| {
            if share == 1 || rows[0][0] > 0.0 {
                rows[0][0] = f64::NAN;
            }
        };
        let mut deployed = Deployed { after: &broken, ..Deployed::plain() };
        let found = admit(&fingerprint, &mut deployed).unwrap();
        assert!(!found.is_admitted() && found.differences.len() == 1, "{found:?}");
        assert!(found.differences[0].contains("not finite"), "{found:?}");
    }
    let short = |rows: &mut Vec<Vec<f64>>| {
        if rows[0][0] > 0.0 {
            rows.truncate(2);
        }
    };
    let found = admit(&fingerprint, &mut Deployed { after: &short, ..Deployed::plain() }).unwrap();
    assert!(found.differences.iter().all(|words| words.contains("actions")), "{found:?}");
}

#[test]
fn random_answers_are_compared_as_distributions() {
    struct Noisy(robogate_core::Stream, f64);
    impl Asked for Noisy {
        fn ask(&mut self, query: &Query) -> Result<Chunk, PolicyError> {
            let mut rows = answer(query, 1);
            rows.iter_mut().flatten().for_each(|x| *x += 0.05 * self.0.normal() + self.1);
            Chunk::of_rows(rows)
        }

        fn declared(&self) -> &Json {
            &Json::Null
        }
    }
    let noisy = |seed: u64, shift: f64| Noisy(robogate_core::Seed::campaign(seed).stream("noise"), shift);
    let profile = Profile::from_toml(Profile::built_in("pi0-libero").unwrap()).unwrap();
    let judged = Fingerprint::measure((0..20).map(query).collect(), &mut noisy(1, 0.0), &profile, 0.05).unwrap();
    assert!(judged.is_random());
    assert_eq!((judged.probes.len(), judged.probes[0].answers.len()), (16, 16));
    for seed in 2..7 {
        assert!(admit(&judged, &mut noisy(seed, 0.0)).unwrap().is_admitted(), "{seed}");
        assert!(!admit(&judged, &mut noisy(seed, 0.03)).unwrap().is_admitted(), "{seed}");
    }
}

#[test]
fn file_keeps_everything() {
    let judged = judged();
    let bytes = judged.to_bytes().unwrap();
    assert_eq!(Fingerprint::from_bytes(&bytes).unwrap(), judged);
    assert_eq!(judged.to_bytes().unwrap(), bytes);
}

#[test]
fn damaged_files_are_errors() {
    let bytes = judged().to_bytes().unwrap();
    for end in (0..bytes.len()).step_by(997) {
        assert!(Fingerprint::from_bytes(&bytes[..end]).is_err(), "{end}");
    }
    for at in (0..bytes.len()).step_by(499) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0xff;
        // Some bytes are those of a pixel or of a number. No damage is a panic.
        let _ = Fingerprint::from_bytes(&damaged);
    }
    assert!(Fingerprint::from_bytes(b"{}").unwrap_err().to_string().contains("fingerprint"));
}
