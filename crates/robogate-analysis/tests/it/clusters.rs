//! Imported results without any effect, whose rows depend on each other in many ways. The program `dependence` of this crate runs
//! them at full size.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use robogate_analysis::{Analysis, AnalysisOptions, Comparison, ComparisonOptions, Source};
use robogate_dictionary::results::{Mapping, import};

/// A reproducible stream of numbers (SplitMix64).
pub(crate) struct Stream(u64);

impl Stream {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x1234_5678_9abc_def0)
    }

    pub(crate) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A standard normal number.
    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.unit()).ln()).sqrt() * (std::f64::consts::TAU * self.unit()).cos()
    }
}

/// How the settings of a design repeat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Settings {
    /// Real numbers, one point for each cluster, read back with this noise.
    Numbers(f64),
    /// Integers from 0 to 999, one point for each cluster.
    Integers,
    /// New real numbers for each row.
    EachRow,
    /// A value for each cluster, with a spread within it that is a tenth of that between clusters.
    Drift,
}

/// A design: clusters with their own rates, and settings that have no effect.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Design {
    pub(crate) name: &'static str,
    pub(crate) clusters: usize,
    pub(crate) rows: usize,
    pub(crate) settings: Settings,
    /// Columns that name the clusters.
    pub(crate) labels: &'static [&'static str],
    /// Whether the rows of a cluster stand together in the file.
    pub(crate) in_blocks: bool,
    /// Mean and standard deviation of the clusters' log-odds of success.
    pub(crate) rates: [f64; 2],
}

const fn design(name: &'static str, clusters: usize, rows: usize, settings: Settings) -> Design {
    Design { name, clusters, rows, settings, labels: &[], in_blocks: false, rates: [1.2, 1.2] }
}

/// The designs in which false claims were seen, and ten more.
pub(crate) const DESIGNS: [Design; 15] = [
    design("15 scenarios x 60, no label", 15, 60, Settings::Numbers(0.0)),
    Design { labels: &["case", "seed"], ..design("15 scenarios x 60, case and seed", 15, 60, Settings::Numbers(0.0)) },
    design("50 x 20, integer parameters", 50, 20, Settings::Integers),
    design("50 x 20, read-back noise 1e-4", 50, 20, Settings::Numbers(1e-4)),
    Design { labels: &["day"], in_blocks: true, ..design("8 days x 60, settings of each day", 8, 60, Settings::Drift) },
    Design { labels: &["day"], ..design("8 days x 60, new settings in each row", 8, 60, Settings::EachRow) },
    design("30 x 30, read-back noise 1e-3", 30, 30, Settings::Numbers(1e-3)),
    design("10 integer scenarios x 60", 10, 60, Settings::Integers),
    Design { labels: &["operator"], ..design("12 operators x 50, new settings", 12, 50, Settings::EachRow) },
    Design {
        labels: &["session_id"],
        in_blocks: true,
        ..design("20 sessions x 40, drifting settings", 20, 40, Settings::Drift)
    },
    Design {
        labels: &["robot_serial"],
        ..design("9 robots x 80, settings of each robot", 9, 80, Settings::Numbers(0.0))
    },
    design("200 x 5, no label", 200, 5, Settings::Numbers(0.0)),
    Design { labels: &["scenario"], ..design("40 scenarios x 10, label and noise", 40, 10, Settings::Numbers(1e-3)) },
    Design {
        in_blocks: true,
        rates: [1.2, 2.0],
        ..design("10 unlabelled days x 60, new settings", 10, 60, Settings::EachRow)
    },
    Design {
        labels: &["case"],
        rates: [2.2, 0.8],
        ..design("60 cases x 10, rate about 0.88", 60, 10, Settings::Numbers(0.0))
    },
];

/// The mean rate of new clusters, by integration over the normal distribution of their log-odds.
pub(crate) fn true_rate([mean, spread]: [f64; 2]) -> f64 {
    let at = |i: i32| f64::from(i) / 100.0;
    let density = |z: f64| (-0.5 * z * z).exp();
    let (sum, all) = (-800..=800)
        .map(at)
        .fold((0.0, 0.0), |(sum, all), z| (sum + density(z) / (1.0 + (-(mean + spread * z)).exp()), all + density(z)));
    sum / all
}

/// The results of a design as CSV. `effect` is the change of the log-odds over the range of the first parameter.
pub(crate) fn table(design: &Design, seed: u64, effect: f64) -> String {
    let mut stream = Stream::new(seed);
    let of_cluster: Vec<(f64, [f64; 4])> = (0..design.clusters)
        .map(|_| {
            let log_odds = design.rates[0] + design.rates[1] * stream.normal();
            (log_odds, [0; 4].map(|_| stream.unit()))
        })
        .collect();
    let n = design.clusters * design.rows;
    let mut order: Vec<usize> = (0..n).collect();
    if !design.in_blocks {
        for last in (1..n).rev() {
            order.swap(last, (stream.unit() * (last + 1) as f64) as usize);
        }
    }
    let mut csv = design.labels.join(",");
    csv += if csv.is_empty() { "" } else { "," };
    csv += "friction,mass_kg,height_m,speed_m_s,success\n";
    for row in order {
        let cluster = row / design.rows;
        let (log_odds, point) = of_cluster[cluster];
        for label in design.labels {
            match *label {
                // The number of the repeat.
                "seed" => write!(csv, "{},", row % design.rows).unwrap(),
                name => write!(csv, "{name}_{cluster},").unwrap(),
            }
        }
        let mut first = point[0];
        for (at, value) in point.into_iter().enumerate() {
            let value = match design.settings {
                Settings::Numbers(noise) => value + noise * (stream.unit() - 0.5),
                Settings::Integers => (1_000.0 * value).floor(),
                Settings::EachRow => stream.unit(),
                Settings::Drift => value + 0.1 * (stream.unit() - 0.5),
            };
            if at == 0 && design.settings != Settings::Integers {
                first = value;
            }
            write!(csv, "{value},").unwrap();
        }
        let p = 1.0 / (1.0 + (-(log_odds + effect * (first - 0.5))).exp());
        writeln!(csv, "{}", u8::from(stream.unit() < p)).unwrap();
    }
    csv
}

/// A CSV as an opened dictionary, in a folder that must outlive it.
pub(crate) fn imported(folder: &Path, name: &str, csv: &str) -> (Source, PathBuf) {
    let (from, to) = (folder.join(format!("{name}.csv")), folder.join(format!("{name}.parquet")));
    std::fs::write(&from, csv).unwrap();
    import(&from, &to, None, &Mapping::default()).unwrap();
    (Source::open(&to).unwrap(), to)
}

/// The analysis of a design without models.
pub(crate) fn analysed(design: &Design, seed: u64, effect: f64) -> Analysis {
    let folder = tempfile::tempdir().unwrap();
    let (source, path) = imported(folder.path(), "results", &table(design, seed, effect));
    Analysis::with(&source, &path, &AnalysisOptions { models: false, ..AnalysisOptions::default() }).unwrap()
}

/// The p-value of a comparison of two policies with equal mean rates, each with its own rate in each scenario.
pub(crate) fn compared(scenarios: usize, seeds: usize, seed: u64) -> f64 {
    let folder = tempfile::tempdir().unwrap();
    let policy = |name: &str, stream: &mut Stream| {
        let mut csv = "case,seed,success\n".to_owned();
        for scenario in 0..scenarios {
            let rate = 1.0 / (1.0 + (-1.0 - 1.2 * stream.normal()).exp());
            for repeat in 0..seeds {
                writeln!(csv, "scenario_{scenario},{repeat},{}", u8::from(stream.unit() < rate)).unwrap();
            }
        }
        imported(folder.path(), name, &csv)
    };
    let mut stream = Stream::new(seed);
    let sources = [policy("a", &mut stream), policy("b", &mut stream)];
    let found = Comparison::of(&sources, &ComparisonOptions { common: true, ..ComparisonOptions::default() });
    found.map_or(1.0, |found| found.differences[0].adjusted_p)
}
