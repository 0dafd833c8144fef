//! Streaming minimum, maximum, mean and standard deviation.

use serde_json::{Value, json};

/// Statistics of each number of a feature. Standard deviations are those of the population, as in LeRobot.
#[derive(Debug, Clone, Default)]
pub(crate) struct Moments {
    frames: u64,
    /// The number of values in each entry below.
    count: f64,
    entries: Vec<[f64; 4]>,
}

impl Moments {
    /// Adds the values of one frame.
    pub(crate) fn note(&mut self, values: &[f64]) {
        let moments: Vec<[f64; 4]> = values.iter().map(|x| [*x, *x, *x, x * x]).collect();
        self.note_all(&moments, 1.0);
    }

    /// Adds minimum, maximum, sum and sum of squares of `count` values of one frame.
    pub(crate) fn note_all(&mut self, moments: &[[f64; 4]], count: f64) {
        if self.frames == 0 {
            self.entries = moments.iter().map(|_| [f64::INFINITY, f64::NEG_INFINITY, 0.0, 0.0]).collect();
        }
        for (entry, new) in self.entries.iter_mut().zip(moments) {
            *entry = [entry[0].min(new[0]), entry[1].max(new[1]), entry[2] + new[2], entry[3] + new[3]];
        }
        self.frames += 1;
        self.count += count;
    }

    /// The statistics in the form of `meta/stats.json`. Those of an image have two additional dimensions of size 1.
    pub(crate) fn json(&self, is_image: bool) -> Value {
        let n = self.count;
        let list = |of: &dyn Fn(&[f64; 4]) -> f64| -> Value {
            self.entries.iter().map(|entry| if is_image { json!([[of(entry)]]) } else { json!(of(entry)) }).collect()
        };
        json!({
            "min": list(&|e| e[0]),
            "max": list(&|e| e[1]),
            "mean": list(&|e| e[2] / n),
            "std": list(&|e| (e[3] / n - (e[2] / n).powi(2)).max(0.0).sqrt()),
            "count": [self.frames],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviation_is_of_the_population() {
        let mut moments = Moments::default();
        [1.0, 2.0, 3.0, 6.0].iter().for_each(|x| moments.note(&[*x]));
        // Python: statistics.pstdev([1, 2, 3, 6]) = 1.8708286933869707
        let json = moments.json(false);
        assert_eq!((json["min"][0].as_f64(), json["max"][0].as_f64()), (Some(1.0), Some(6.0)));
        assert_eq!((json["mean"][0].as_f64(), json["count"][0].as_u64()), (Some(3.0), Some(4)));
        assert!((json["std"][0].as_f64().unwrap() - 1.870_828_693_386_970_7).abs() < 1e-12);
    }
}
