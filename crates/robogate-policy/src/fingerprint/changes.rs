//! Changes of a request that a deployment may make by mistake. If a server that is sent the opposite change answers as judged, the
//! change is the cause.

use crate::array::{Array, Dtype};
use crate::query::Query;

/// Changes a request. `None` if it does not fit.
type Edit = dyn Fn(&Query) -> Option<Query>;
/// Changes the numbers of a state.
type EditNumbers = dyn Fn(&mut Vec<f64>);

/// A change of a request.
pub(super) struct Change {
    /// What the deployment does, as a sentence about it.
    pub(super) cause: String,
    apply: Box<Edit>,
}

impl Change {
    fn new(cause: String, apply: impl Fn(&Query) -> Option<Query> + 'static) -> Self {
        Self { cause, apply: Box::new(apply) }
    }

    /// The changed request. `None` if the change has no effect on it.
    pub(super) fn of(&self, query: &Query) -> Option<Query> {
        (self.apply)(query).filter(|changed| changed != query)
    }
}

/// The changes of images: their words, and the source of each pixel (row, column, colour) of an image of this size.
pub(super) const PICTURES: [(&str, Source); 4] = [
    ("mirrored", |[y, x, c], [_, w]| [y, w - 1 - x, c]),
    ("upside down", |[y, x, c], [h, _]| [h - 1 - y, x, c]),
    ("rotated by 180 degrees", |[y, x, c], [h, w]| [h - 1 - y, w - 1 - x, c]),
    ("with red and blue exchanged (BGR)", |[y, x, c], _| [y, x, 2 - c]),
];

pub(super) type Source = fn([usize; 3], [usize; 2]) -> [usize; 3];

/// All changes that fit the requests of a policy.
pub(super) fn changes(of: &Query) -> Vec<Change> {
    let mut found = Vec::new();
    let names: Vec<String> = of.images.iter().map(|(name, _)| name.clone()).collect();
    for (words, source) in PICTURES {
        found.push(Change::new(format!("images arrive {words}"), move |query| {
            let images = query.images.iter().map(|(name, image)| Some((name.clone(), rearranged(image, source)?)));
            Some(Query { images: images.collect::<Option<_>>()?, ..query.clone() })
        }));
        for name in names.iter().filter(|_| names.len() > 1) {
            let wanted = name.clone();
            found.push(Change::new(format!("the image `{name}` arrives {words}"), move |query| {
                changed(query, &wanted, true, |image| rearranged(image, source))
            }));
        }
    }
    found.extend(swaps(&of.images, "the images", true));
    found.extend(swaps(&of.states, "the states", false));
    for (name, state) in &of.states {
        found.extend(numbers(name, state.numbers().len()));
    }
    found
}

/// Exchanges of two inputs of the same form.
fn swaps(inputs: &[(String, Array)], what: &str, images: bool) -> Vec<Change> {
    let mut found = Vec::new();
    for (at, (a, first)) in inputs.iter().enumerate() {
        for (b, second) in &inputs[at + 1..] {
            if first.shape() == second.shape() && first.dtype() == second.dtype() {
                let (a, b) = (a.clone(), b.clone());
                found.push(Change::new(format!("{what} `{a}` and `{b}` are exchanged"), move |query| {
                    let mut query = query.clone();
                    let inputs = if images { &mut query.images } else { &mut query.states };
                    let [i, j] = [&a, &b].map(|name| inputs.iter().position(|(other, _)| other == name));
                    let (i, j) = (i?, j?);
                    let kept = inputs[i].1.clone();
                    inputs[i].1 = inputs[j].1.clone();
                    inputs[j].1 = kept;
                    Some(query)
                }));
            }
        }
    }
    found
}

/// The request without one of its inputs: a black image, a state of zeros, or another instruction.
pub(super) fn without(query: &Query, input: &str) -> Query {
    let mut query = query.clone();
    match query.images.iter_mut().chain(&mut query.states).find(|(name, _)| name == input) {
        Some((_, array)) => {
            let zeros = vec![0; array.data().len()];
            if let Ok(blank) = Array::new(array.dtype(), array.shape().to_vec(), zeros) {
                *array = blank;
            }
        }
        None => "do nothing".clone_into(&mut query.instruction),
    }
    query
}

/// The names of all inputs of a request.
pub(super) fn inputs(query: &Query) -> Vec<String> {
    let named = query.images.iter().chain(&query.states).map(|(name, _)| name.clone());
    named.chain([INSTRUCTION.to_owned()]).collect()
}

/// The name of the instruction among the inputs.
const INSTRUCTION: &str = "instruction";

/// Changes of the numbers of a state. Factors are those that the server applies; the request gets their inverse.
fn numbers(name: &str, n: usize) -> Vec<Change> {
    let degrees = 180.0 / std::f64::consts::PI;
    let factors = [
        (degrees, "in degrees in place of radians"),
        (1.0 / degrees, "in radians in place of degrees"),
        (1000.0, "in millimetres in place of metres"),
        (0.001, "in metres in place of millimetres"),
        (-1.0, "with the opposite sign"),
    ];
    let mut found = Vec::new();
    let mut add = |cause: String, change: Box<EditNumbers>| {
        let wanted = name.to_owned();
        found.push(Change::new(cause, move |query| {
            changed(query, &wanted, false, |array| {
                let mut values = array.numbers();
                change(&mut values);
                Array::new(array.dtype(), array.shape().to_vec(), bytes(&values, array.dtype())?).ok()
            })
        }));
    };
    for (factor, words) in factors {
        let scale = move |values: &mut Vec<f64>| values.iter_mut().for_each(|value| *value /= factor);
        add(format!("the state `{name}` arrives {words}"), Box::new(scale));
        for at in (0..n).filter(|_| n > 1 && n <= MOST_NUMBERS) {
            let words = format!("number {} of the state `{name}` arrives {words}", at + 1);
            add(words, Box::new(move |values| values[at] /= factor));
        }
    }
    for at in (0..n).filter(|_| n <= MOST_NUMBERS) {
        let words = format!("number {} of the state `{name}` arrives as one minus it", at + 1);
        add(words, Box::new(move |values| values[at] = 1.0 - values[at]));
    }
    add(format!("the numbers of the state `{name}` arrive in reverse order"), Box::new(|values| values.reverse()));
    for first in 0..n.saturating_sub(3).min(MOST_NUMBERS) {
        for (words, left) in
            [("scalar first in place of scalar last", true), ("scalar last in place of scalar first", false)]
        {
            let words = format!(
                "numbers {} to {} of the state `{name}` are a quaternion with the {words}",
                first + 1,
                first + 4
            );
            let turn = move |values: &mut Vec<f64>| {
                let part = &mut values[first..first + 4];
                if left { part.rotate_left(1) } else { part.rotate_right(1) }
            };
            add(words, Box::new(turn));
        }
    }
    found
}

/// A longer state is changed as a whole only.
const MOST_NUMBERS: usize = 16;

/// The request with one changed input.
fn changed(query: &Query, name: &str, image: bool, change: impl Fn(&Array) -> Option<Array>) -> Option<Query> {
    let mut query = query.clone();
    let inputs = if image { &mut query.images } else { &mut query.states };
    let (_, array) = inputs.iter_mut().find(|(other, _)| other == name)?;
    *array = change(array)?;
    Some(query)
}

fn bytes(values: &[f64], dtype: Dtype) -> Option<Vec<u8>> {
    match dtype {
        Dtype::F32 => Some(values.iter().flat_map(|value| (*value as f32).to_le_bytes()).collect()),
        Dtype::F64 => Some(values.iter().flat_map(|value| value.to_le_bytes()).collect()),
        _ => None,
    }
}

/// An image, or a stack of images, with rows of colours or planes of colours, whose pixels come from other places.
pub(super) fn rearranged(image: &Array, source: Source) -> Option<Array> {
    let (leading, size) = image.shape().split_at(image.shape().len().checked_sub(3)?);
    let (h, w, planes) = match size {
        [h, w, 3] => (*h, *w, false),
        [3, h, w] => (*h, *w, true),
        _ => return None,
    };
    let at = |[y, x, c]: [usize; 3]| if planes { (c * h + y) * w + x } else { (y * w + x) * 3 + c };
    let of_one = 3 * h * w;
    let mut data = vec![0; image.data().len()];
    for start in (0..leading.iter().product::<usize>()).map(|one| one * of_one) {
        for place in (0..h).flat_map(|y| (0..w).flat_map(move |x| (0..3).map(move |c| [y, x, c]))) {
            *data.get_mut(start + at(place))? = *image.data().get(start + at(source(place, [h, w])))?;
        }
    }
    Array::new(image.dtype(), image.shape().to_vec(), data).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layouts_agree() {
        let pixels: Vec<u8> = (0..18).collect();
        let rows = Array::new(Dtype::U8, vec![3, 2, 3], pixels.clone()).unwrap();
        let planar: Vec<u8> = (0..3).flat_map(|c| pixels.iter().skip(c).step_by(3).copied()).collect();
        let planes = Array::new(Dtype::U8, vec![1, 3, 3, 2], planar).unwrap();
        for (words, source) in PICTURES {
            // An image of three rows could be either; the last dimension decides.
            let rows = rearranged(&rows, source).unwrap();
            let planes = rearranged(&planes, source).unwrap();
            let again: Vec<u8> = (0..3).flat_map(|c| rows.data().iter().skip(c).step_by(3).copied()).collect();
            assert_eq!(planes.data(), again, "{words}");
            assert_eq!(rearranged(&rows, source).unwrap().data(), pixels, "{words} twice");
        }
    }
}
