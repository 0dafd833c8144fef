//! Tests of the properties that all samplers share, and of those of each sampler.
#![expect(clippy::disallowed_methods, reason = "tests measure times")]
#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;

use robogate_core::samplers::{LatinHypercube, NAMES, Sobol, Uniform, by_name};
use robogate_core::{Design, DesignError, Domain, ParameterSpace, Sampler, Seed, Stream};

const FRANKA: &str = include_str!("../../../assets/spaces/franka.toml");

fn franka() -> Arc<ParameterSpace> {
    Arc::new(ParameterSpace::from_toml(FRANKA).unwrap())
}

/// `d` numbers in [0, 1).
fn cube(d: usize) -> Arc<ParameterSpace> {
    let parameter = |i| format!("[[parameter]]\nname = \"x{i}\"\nkind = \"continuous\"\nlow = 0\nhigh = 1\n");
    let text = format!("name = \"cube\"\n{}", (0..d).map(parameter).collect::<String>());
    Arc::new(ParameterSpace::from_toml(&text).unwrap())
}

/// One parameter on a log scale over eight decades.
fn decades() -> Arc<ParameterSpace> {
    let text =
        "name = \"d\"\n[[parameter]]\nname = \"x\"\nkind = \"continuous\"\nlow = 1e-6\nhigh = 100\nscale = \"log\"";
    Arc::new(ParameterSpace::from_toml(text).unwrap())
}

fn stream(seed: u64) -> Stream {
    Seed::campaign(seed).stream("design")
}

fn column(design: &Design, j: usize) -> Vec<f64> {
    (0..design.len()).map(|i| design.coded(i).unwrap()[j]).collect()
}

fn continuous(space: &ParameterSpace) -> Vec<usize> {
    (0..space.len()).filter(|j| space.parameters()[*j].domain.levels().is_none()).collect()
}

/// The continuous parameters of each point, in unit coordinates.
fn cloud(design: &Design) -> Vec<Vec<f64>> {
    let parameters = design.space().parameters();
    let columns = continuous(design.space());
    let unit = |i| columns.iter().map(|j| parameters[*j].domain.to_unit(design.coded(i).unwrap()[*j])).collect();
    (0..design.len()).map(unit).collect()
}

fn smallest_distance(cloud: &[Vec<f64>]) -> f64 {
    let squared = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>();
    let pairs = cloud.iter().enumerate().flat_map(|(i, a)| cloud[..i].iter().map(move |b| squared(a, b)));
    pairs.fold(f64::INFINITY, f64::min).sqrt()
}

fn largest_correlation(cloud: &[Vec<f64>]) -> f64 {
    let (n, d) = (cloud.len() as f64, cloud[0].len());
    let centred = |j: usize| {
        let mean = cloud.iter().map(|x| x[j]).sum::<f64>() / n;
        cloud.iter().map(|x| x[j] - mean).collect::<Vec<_>>()
    };
    let columns: Vec<_> = (0..d).map(centred).collect();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let correlation = |i: usize, j: usize| {
        dot(&columns[i], &columns[j]) / (dot(&columns[i], &columns[i]) * dot(&columns[j], &columns[j])).sqrt()
    };
    (0..d).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| correlation(i, j).abs()).fold(0.0, f64::max)
}

#[test]
fn names_match_samplers() {
    for name in NAMES {
        assert_eq!(by_name(name).unwrap().name(), name);
    }
    assert!(by_name("Sobol").is_none());
    assert!(by_name("").is_none());
}

#[test]
fn empty_design_is_rejected() {
    for name in NAMES {
        assert_eq!(by_name(name).unwrap().design(&franka(), 0, stream(1)), Err(DesignError::Empty), "{name}");
    }
}

#[test]
fn exceeded_limit_is_rejected() {
    let many = (1 << 31) + 1;
    let error = Sobol.design(&franka(), many, stream(1)).unwrap_err();
    assert_eq!(error, DesignError::Limit { sampler: "sobol", what: "points", limit: 1 << 31, asked: many });
    let error = Sobol.design(&cube(65), 8, stream(1)).unwrap_err();
    assert_eq!(error, DesignError::Limit { sampler: "sobol", what: "parameters", limit: 64, asked: 65 });
    assert_eq!(error.to_string(), "sobol is defined up to 64 parameters (requested: 65)");
    assert!(Sobol.design(&cube(64), 8, stream(1)).is_ok());
    let error = LatinHypercube::default().design(&franka(), many, stream(1)).unwrap_err();
    assert_eq!(error, DesignError::Limit { sampler: "latin_hypercube", what: "points", limit: 1 << 26, asked: many });
}

#[test]
fn design_depends_only_on_stream() {
    for name in NAMES {
        for n in [1, 2, 3, 7, 100] {
            let draw = |seed| by_name(name).unwrap().design(&franka(), n, stream(seed)).unwrap();
            assert_eq!(draw(1), draw(1), "{name} {n}");
            assert_ne!(draw(1), draw(2), "{name} {n}");
        }
    }
}

#[test]
fn values_are_in_their_domains() {
    for name in NAMES {
        for n in [1, 2, 3, 7, 100, 10_000] {
            let design = by_name(name).unwrap().design(&franka(), n, stream(n as u64)).unwrap();
            assert_eq!(design.len(), n);
            for (j, parameter) in franka().parameters().iter().enumerate() {
                for x in column(&design, j) {
                    let inside = match &parameter.domain {
                        Domain::Continuous { low, high, .. } => (*low..=*high).contains(&x),
                        Domain::Integer { low, high } => x.fract() == 0.0 && (*low..=*high).contains(&(x as i64)),
                        Domain::Categorical { choices } => x.fract() == 0.0 && (x as usize) < choices.len(),
                    };
                    assert!(inside, "{name} {n}: {} = {x}", parameter.name);
                }
            }
        }
    }
}

#[test]
fn levels_are_balanced() {
    for sampler in [&LatinHypercube::default() as &dyn Sampler, &Sobol] {
        for n in [1, 2, 3, 7, 8, 100, 128, 1_000, 10_000] {
            let design = sampler.design(&franka(), n, stream(n as u64)).unwrap();
            for (j, parameter) in franka().parameters().iter().enumerate() {
                let Some(levels) = parameter.domain.levels() else { continue };
                let mut counts = vec![0; levels];
                for x in column(&design, j) {
                    let first = if let Domain::Integer { low, .. } = parameter.domain { low as f64 } else { 0.0 };
                    counts[(x - first) as usize] += 1;
                }
                let fair = n / levels..=n.div_ceil(levels);
                assert!(counts.iter().all(|c| fair.contains(c)), "{} {n}: {counts:?}", sampler.name());
            }
        }
    }
}

#[test]
fn single_point_level_is_uniform() {
    // Six levels of 1,000 +- 29 each. The tolerance is five standard deviations.
    for sampler in [&LatinHypercube::default() as &dyn Sampler, &Sobol] {
        let obstacles = franka().position("obstacles").unwrap();
        let mut counts = [0_i32; 6];
        for seed in 0..6_000 {
            let design = sampler.design(&franka(), 1, stream(seed)).unwrap();
            counts[design.coded(0).unwrap()[obstacles] as usize] += 1;
        }
        assert!(counts.iter().all(|c| (c - 1_000).abs() < 145), "{} {counts:?}", sampler.name());
    }
}

#[test]
fn discrete_columns_are_independent() {
    // Mean friction within each shape: 2,000 points of a column with standard deviation 1/sqrt(12). The tolerance is
    // five standard errors.
    let design = LatinHypercube::default().design(&franka(), 10_000, stream(4)).unwrap();
    let shape = column(&design, franka().position("shape").unwrap());
    for j in 0..5 {
        for level in 0..5 {
            let of_level: Vec<f64> =
                cloud(&design).iter().zip(&shape).filter(|(_, s)| **s as usize == level).map(|(x, _)| x[j]).collect();
            let mean = of_level.iter().sum::<f64>() / of_level.len() as f64;
            assert!((mean - 0.5).abs() < 5.0 / (12.0 * 2_000.0_f64).sqrt(), "column {j} level {level}: {mean}");
        }
    }
}

#[test]
fn each_stratum_has_one_point() {
    for space in [franka(), cube(1), cube(2), decades()] {
        for n in [1, 2, 3, 7, 100, 10_000] {
            let design = LatinHypercube::default().design(&space, n, stream(n as u64)).unwrap();
            for j in continuous(&space) {
                let domain = &space.parameters()[j].domain;
                let mut values = column(&design, j);
                // Mapped back to the unit interval. Points are farther from the edges than the rounding error.
                let mut strata: Vec<_> = values.iter().map(|x| (domain.to_unit(*x) * n as f64) as usize).collect();
                strata.sort_unstable();
                assert!(strata.into_iter().eq(0..n), "{} n {n} column {j}", space.name());
                // Also without the inverse: the k-th smallest value is in the image of the k-th stratum.
                values.sort_by(f64::total_cmp);
                for (k, x) in values.into_iter().enumerate() {
                    let edge = |k: usize| domain.from_unit(k as f64 / n as f64);
                    assert!(edge(k) <= x && x <= edge(k + 1), "{} n {n} column {j} stratum {k}", space.name());
                }
            }
        }
    }
}

#[test]
fn maximin_increases_smallest_distance() {
    // (n, d, gain): the expected gain grows with n, because random designs get worse with n.
    for (n, d, gain) in [(10, 2, 1.2), (20, 5, 1.2), (100, 2, 2.0), (100, 5, 1.7), (1_000, 5, 2.5), (1_000, 10, 1.4)] {
        for seed in 0..5 {
            let drawn = LatinHypercube { budget: 0 }.design(&cube(d), n, stream(seed)).unwrap();
            let moved = LatinHypercube::default().design(&cube(d), n, stream(seed)).unwrap();
            let (before, after) = (smallest_distance(&cloud(&drawn)), smallest_distance(&cloud(&moved)));
            assert!(after > gain * before, "n {n} d {d} seed {seed}: {before} -> {after}");
        }
    }
}

#[test]
fn maximin_handles_ten_thousand_points() {
    let drawn = LatinHypercube { budget: 0 }.design(&franka(), 10_000, stream(2026)).unwrap();
    let moved = LatinHypercube::default().design(&franka(), 10_000, stream(2026)).unwrap();
    let (before, after) = (smallest_distance(&cloud(&drawn)), smallest_distance(&cloud(&moved)));
    assert!(after > 0.12 && after > 4.0 * before, "{before} -> {after}");
}

#[test]
fn budget_never_lowers_smallest_distance() {
    for (n, d) in [(2, 2), (3, 5), (7, 3), (50, 4)] {
        for seed in 0..20 {
            let mut last = 0.0;
            for budget in [0, 100, 10_000, 1_000_000] {
                let design = LatinHypercube { budget }.design(&cube(d), n, stream(seed)).unwrap();
                let distance = smallest_distance(&cloud(&design));
                assert!(distance >= last, "n {n} d {d} seed {seed} budget {budget}: {last} -> {distance}");
                last = distance;
            }
        }
    }
}

#[test]
fn hypercube_columns_are_nearly_uncorrelated() {
    for (n, d) in [(100, 2), (100, 5), (1_000, 5), (1_000, 10), (10_000, 5)] {
        let design = LatinHypercube::default().design(&cube(d), n, stream(6)).unwrap();
        let largest = largest_correlation(&cloud(&design));
        // 0.05 at a hundred points. Random columns have a standard deviation of 1/sqrt(n) per pair.
        assert!(largest < 2.0 / (n as f64).sqrt(), "n {n} d {d}: {largest}");
    }
}

#[test]
fn sobol_fills_each_stratum() {
    let design = Sobol.design(&franka(), 1_024, stream(8)).unwrap();
    for (j, _) in continuous(&franka()).into_iter().enumerate() {
        let mut strata: Vec<_> = cloud(&design).iter().map(|x| (x[j] * 1_024.0) as usize).collect();
        strata.sort_unstable();
        assert!(strata.into_iter().eq(0..1_024), "column {j}");
    }
}

#[test]
fn uniform_points_are_independent() {
    // The first points of a larger uniform design are the smaller design: draws are independent of n and of each other.
    let many = Uniform.design(&franka(), 100, stream(1)).unwrap();
    let few = Uniform.design(&franka(), 10, stream(1)).unwrap();
    assert!((0..10).all(|i| many.coded(i) == few.coded(i)));
}

#[test]
#[ignore = "prints figures: cargo test --release -p robogate-core --test samplers figures -- --ignored --nocapture"]
fn figures() {
    for name in NAMES {
        let start = std::time::Instant::now();
        let design = by_name(name).unwrap().design(&franka(), 10_000, stream(1)).unwrap();
        println!(
            "{name}: 10,000 points of franka in {:?}, smallest distance {:.4}",
            start.elapsed(),
            smallest_distance(&cloud(&design))
        );
    }
    for (n, d) in [
        (7, 3),
        (10, 2),
        (20, 5),
        (100, 2),
        (100, 5),
        (1_000, 5),
        (1_000, 10),
        (10_000, 2),
        (10_000, 5),
        (10_000, 8),
        (10_000, 20),
    ] {
        for seed in 0..3 {
            let drawn = LatinHypercube { budget: 0 }.design(&cube(d), n, stream(seed)).unwrap();
            let start = std::time::Instant::now();
            let moved = LatinHypercube::default().design(&cube(d), n, stream(seed)).unwrap();
            let elapsed = start.elapsed();
            println!(
                "n {n} d {d}: smallest distance {:.4} -> {:.4}, largest correlation {:.5} -> {:.5}, {elapsed:?}",
                smallest_distance(&cloud(&drawn)),
                smallest_distance(&cloud(&moved)),
                largest_correlation(&cloud(&drawn)),
                largest_correlation(&cloud(&moved)),
            );
        }
    }
    let start = std::time::Instant::now();
    LatinHypercube::default().design(&franka(), 1_000_000, stream(1)).unwrap();
    println!("latin_hypercube: 1,000,000 points in {:?}", start.elapsed());
}

/// Hashes of a thousand points of the Franka's space, recorded before spaces could have correlations.
const BITS: [(&str, u64); 3] =
    [("latin_hypercube", 0x869c_6235_57b2_ca33), ("sobol", 0x5688_d737_45c7_6b02), ("uniform", 0xf023_0cca_b5e2_a83a)];

#[test]
#[cfg_attr(not(all(target_os = "linux", target_arch = "x86_64")), ignore = "ln and exp differ between platforms")]
fn uncorrelated_space_keeps_its_bits() {
    for (name, bits) in BITS {
        let design = by_name(name).unwrap().design(&franka(), 1000, stream(2026)).unwrap();
        let bytes = (0..1000).flat_map(|i| design.coded(i).unwrap().to_vec()).flat_map(|x| x.to_bits().to_le_bytes());
        let hash = bytes
            .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3));
        assert_eq!(hash, bits, "{name}");
    }
}

/// The Franka's space with correlations: heavy objects are large, rough ones light.
fn correlated() -> Arc<ParameterSpace> {
    let more = "[[correlation]]\nparameters = [\"mass_kg\", \"size_m\"]\nrank = 0.8\n\
                [[correlation]]\nparameters = [\"friction\", \"mass_kg\"]\nrank = -0.4\n";
    Arc::new(ParameterSpace::from_toml(&format!("{FRANKA}{more}")).unwrap())
}

fn ranked(x: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..x.len()).collect();
    order.sort_by(|a, b| x[*a].total_cmp(&x[*b]));
    let mut ranks = vec![0.0; x.len()];
    for (rank, i) in order.into_iter().enumerate() {
        ranks[i] = rank as f64;
    }
    ranks
}

/// Spearman's rank correlation of two columns without ties.
fn spearman(design: &Design, a: &str, b: &str) -> f64 {
    let [a, b] = [a, b].map(|name| ranked(&column(design, design.space().position(name).unwrap())));
    let n = a.len() as f64;
    1.0 - 6.0 * a.iter().zip(&b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / (n * (n * n - 1.0))
}

#[test]
fn samplers_match_requested_correlations() {
    for (name, n) in NAMES.into_iter().flat_map(|name| [(name, 200), (name, 4000)]) {
        let design = by_name(name).unwrap().design(&correlated(), n, stream(1)).unwrap();
        // Five standard errors of independent draws. A reordered hypercube must be far closer.
        let off = if name == "latin_hypercube" { 1.0 / n as f64 } else { 5.0 / (n as f64).sqrt() };
        let asked = [
            ("mass_kg", "size_m", 0.8),
            ("friction", "mass_kg", -0.4),
            ("friction", "size_m", 0.0),
            ("mass_kg", "com_offset", 0.0),
            ("com_offset", "ik_noise_rad", 0.0),
        ];
        for (a, b, rank) in asked {
            let found = spearman(&design, a, b);
            assert!((found - rank).abs() < off, "{name}: {a} {b} {found}, not {rank}");
        }
    }
}

#[test]
fn correlated_hypercube_keeps_strata_and_levels() {
    for n in [1, 2, 5, 6, 100, 2001] {
        let design = LatinHypercube::default().design(&correlated(), n, stream(3)).unwrap();
        for j in continuous(design.space()) {
            let domain = &design.space().parameters()[j].domain;
            let mut strata: Vec<usize> =
                column(&design, j).iter().map(|x| ((domain.to_unit(*x) * n as f64) as usize).min(n - 1)).collect();
            strata.sort_unstable();
            assert!(strata.into_iter().eq(0..n), "n {n} column {j}");
        }
        let shape = column(&design, design.space().position("shape").unwrap());
        for level in 0..5 {
            let count = shape.iter().filter(|s| **s as usize == level).count();
            assert!((n / 5..=n.div_ceil(5)).contains(&count), "n {n} level {level}: {count}");
        }
    }
}

#[test]
fn correlated_columns_stay_even_and_repeatable() {
    for name in NAMES {
        let sampler = by_name(name).unwrap();
        let design = sampler.design(&correlated(), 4096, stream(5)).unwrap();
        assert_eq!(design, sampler.design(&correlated(), 4096, stream(5)).unwrap(), "{name}");
        for j in continuous(design.space()) {
            let domain = &design.space().parameters()[j].domain;
            let mut cells = [0_u32; 16];
            column(&design, j).iter().for_each(|x| cells[((domain.to_unit(*x) * 16.0) as usize).min(15)] += 1);
            // 16 cells of 256 +- 15.5 for independent draws. The tolerance is five standard deviations.
            assert!(cells.iter().all(|c| c.abs_diff(256) < 78), "{name} {j}: {cells:?}");
        }
    }
}
