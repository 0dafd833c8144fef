//! Writes docs/results/contests.md: errors, power and length of the tests in [`robogate_stats::contest`].
//!
//! `cargo run --release -p robogate-stats --example contests -- "27 November 2026" docs/results/contests.md`
//!
//! Contests of two policies and tests of a limit are exact recursions; the others are simulated with fixed seeds.

use std::fmt::Write as _;

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use robogate_stats::budgeted::Budget;
use robogate_stats::contest::{ContestError, Decision, Duel, Elimination, Guarantee, Predicted, Schedule, Truth};
use robogate_stats::operating::{Answer, RateTest, Schedule as Trials, characteristics};

const CONTESTS: u64 = 2_000;
const GUARANTEES: [(Guarantee, &str); 2] =
    [(Guarantee::BestStays, "best stays"), (Guarantee::NoFalseElimination, "no false elimination")];

fn main() -> std::io::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let (Some(date), Some(path)) = (arguments.next(), arguments.next()) else {
        return Err(std::io::Error::other("expected a date and the file to write"));
    };
    let mut out = String::from("# Contests of policies\n\n");
    let _ = writeln!(
        out,
        "{date}. `cargo run --release -p robogate-stats --example contests -- \"{date}\" docs/results/contests.md` writes this page. \
         All random numbers have fixed seeds. A block is one trial of each policy; the error probability is 5 % everywhere.\n"
    );
    for part in [duels, days, four, eight, limits, predictions] {
        part(&mut out).map_err(std::io::Error::other)?;
    }
    std::fs::write(path, out)
}

fn duels(out: &mut String) -> Result<(), ContestError> {
    out.push_str(
        "## Two policies\n\nExact. Targets: with at most 52 blocks a power of 90 %, on average at most 31.5 blocks, 28 at a correlation of \
         0.3 within the block, and 30 without a difference; with at most 100 blocks 98 % and 34 at 60 against 90 %, 76 % and 64 at \
         80 against 95 %. All are met.\n\n\
         | largest | true rates | correlation | better one shown | worse one shown | mean blocks |\n|---|---|---|---|---|---|\n",
    );
    for blocks in [52, 100] {
        let duel = Duel::new(blocks, 0.05)?;
        for (first, second) in [(0.9, 0.6), (0.95, 0.8), (0.6, 0.6), (0.75, 0.75), (0.9, 0.9)] {
            for correlation in [0.0, 0.3] {
                let found = duel.expected(Truth { first, second, correlation });
                let _ = writeln!(
                    out,
                    "| {blocks} | {first} / {second} | {correlation} | {:.3} | {:.4} | {:.1} |",
                    found.first_better, found.second_better, found.blocks
                );
            }
        }
    }
    Ok(())
}

/// Contests of equal policies whose rates change from day to day and with the operator, with missing blocks.
fn days(out: &mut String) -> Result<(), ContestError> {
    const STUDIES: u64 = 20_000;
    out.push_str(
        "\n### Days, operators, and missing blocks\n\nEqual policies in 20,000 simulated studies of at most 52 blocks. The rate of \
         both changes every ten blocks between 0.3 and 0.97 and with one of two operators by 0.1; half of the outcomes of a block \
         are decided by one draw; 10 % of the blocks are missing at random. Target: at most 5.5 % wrong.\n\n\
         | study | wrong | mean blocks |\n|---|---|---|\n",
    );
    let plan = Duel::new(52, 0.05)?;
    for (name, changing, missing) in
        [("constant", false, 0.0), ("days and operators", true, 0.0), ("the same, blocks missing", true, 0.1)]
    {
        let (mut wrong, mut blocks) = (0_u64, 0_u64);
        for study in 0..STUDIES {
            let random = &mut ChaCha8Rng::seed_from_u64(study);
            let mut duel = plan.clone();
            let mut day = 0.75;
            for block in 0..52 {
                if changing && block % 10 == 0 {
                    day = 0.3 + 0.67 * unit(random);
                }
                let operator = if changing && unit(random) < 0.5 { 0.1 } else { 0.0 };
                let rate = day - operator;
                let draws = [unit(random), unit(random)];
                let shared = unit(random) < 0.5;
                if unit(random) < missing {
                    continue;
                }
                blocks += 1;
                match duel.block(draws[0] < rate, draws[usize::from(!shared)] < rate) {
                    Decision::GoOn => {}
                    Decision::NoDifferenceShown => break,
                    Decision::FirstBetter | Decision::SecondBetter => {
                        wrong += 1;
                        break;
                    }
                }
            }
        }
        let share = |n: u64| n as f64 / STUDIES as f64;
        let _ = writeln!(out, "| {name} | {:.2} % | {:.1} |", 100.0 * share(wrong), share(blocks));
    }
    Ok(())
}

fn four(out: &mut String) -> Result<(), ContestError> {
    out.push_str(
        "\n## Best of four on a real robot\n\n2,000 contests each, a look after each block, independent outcomes. Targets at 0.9 and \
         three of 0.6: first elimination after at most 31 blocks and 175 trials (best stays), 41 and 220 (no false elimination), \
         and the best alone in at least 80 % with at most 210 trials; at 0.95 and three of 0.8 the best alone in 19 %; the best \
         dropped in at most 5 %. All are met.\n\n\
         | guarantee | true rates | best alone | a best one dropped | any best one dropped | first leaves after | trials |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for (guarantee, name) in GUARANTEES {
        let contest = Elimination::new(4, Schedule { per_look: 1, looks: 90 }, guarantee, 0.05)?;
        for rates in [[0.9, 0.6, 0.6, 0.6], [0.95, 0.8, 0.8, 0.8], [0.8, 0.7, 0.6, 0.5], [0.6; 4], [0.9; 4]] {
            let found = contest.expected(&rates, 0.0, CONTESTS, 1)?;
            let alone = if rates[0] > rates[1] { percent(found.best_alone) } else { "-".to_owned() };
            let _ = writeln!(
                out,
                "| {name} | {} | {alone} | {} | {} | {:.1} | {:.0} |",
                rates.map(|rate| rate.to_string()).join(", "),
                percent(found.best_dropped),
                percent(found.any_best_dropped),
                found.first_after.unwrap_or(f64::NAN),
                found.trials
            );
        }
    }
    Ok(())
}

/// The smallest number of blocks, in steps of 25, with which a single look finds the best one in 90 % of contests.
fn fixed(guarantee: Guarantee, rates: &[f64; 8], shared: f64) -> Result<u64, ContestError> {
    for n in (400..4_000).step_by(25) {
        let contest = Elimination::new(8, Schedule { per_look: n, looks: 1 }, guarantee, 0.05)?;
        if contest.expected(rates, shared, 500, n)?.best_alone >= 0.9
            && contest.expected(rates, shared, CONTESTS, n)?.best_alone >= 0.9
        {
            return Ok(n);
        }
    }
    Ok(4_000)
}

fn eight(out: &mut String) -> Result<(), ContestError> {
    let rates = [0.9, 0.85, 0.85, 0.85, 0.85, 0.85, 0.85, 0.85];
    out.push_str(
        "\n## Best of eight in simulation\n\nOne policy at 0.9 and seven at 0.85; 30 looks. With a correlation of 0.5, one draw decides \
         63 % of the scenarios for all policies. The fixed design has one look and finds the best one in 90 % of 2,000 contests; the \
         largest number of the contest is the smallest with the same power. Targets: at most 0.62 of the trials of the fixed design \
         with the same pairing, at most 0.35 of the one with independent scenarios, at most 1.2 if all are equal (rate 0.85), and \
         an error of at most 6 %. All are met.\n\n\
         | guarantee | correlation | fixed design | largest | best alone | trials / same pairing | trials / independent | \
         all equal: trials | error |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    for (guarantee, name) in GUARANTEES {
        let independent = fixed(guarantee, &rates, 0.0)?;
        for (shared, correlation) in [(0.0, "0"), (0.63, "0.5")] {
            let n = if shared > 0.0 { fixed(guarantee, &rates, shared)? } else { independent };
            for per_look in n.div_ceil(30).. {
                let contest = Elimination::new(8, Schedule { per_look, looks: 30 }, guarantee, 0.05)?;
                let found = contest.expected(&rates, shared, CONTESTS, 7)?;
                if found.best_alone < 0.9 {
                    continue;
                }
                let equal = contest.expected(&[0.85; 8], shared, CONTESTS, 8)?;
                let error = if guarantee == Guarantee::BestStays { equal.best_dropped } else { equal.any_best_dropped };
                let _ = writeln!(
                    out,
                    "| {name} | {correlation} | {n} | {} | {} | {:.2} | {:.2} | {:.2} | {} |",
                    30 * per_look,
                    percent(found.best_alone),
                    found.trials / (8 * n) as f64,
                    found.trials / (8 * independent) as f64,
                    equal.trials / (8 * n) as f64,
                    percent(error)
                );
                break;
            }
        }
    }
    Ok(())
}

fn limits(out: &mut String) -> Result<(), ContestError> {
    out.push_str(
        "\n## One policy against a limit of 0.8\n\nExact: the test of the gate with a look after each trial, and 5 % for each wrong \
         answer. The first budget is the smallest with a power of 90 %, the second the one with the fewest trials on \
         average. Targets: at most 50 trials on average at 0.92, which is met, and 29 at 0.95, which is missed by one trial.\n\n\
         | true rate | budget | met | not met | mean trials | mean trials at 0.8 |\n|---|---|---|---|---|---|\n",
    );
    let test = RateTest { at_least: 0.8, alpha: 0.05, beta: 0.05 };
    for (rate, most) in [(0.92, 160), (0.95, 100)] {
        let of =
            |rounds| (rounds, characteristics(test, Trials::Budget(Budget { per_round: 1, rounds }), &[rate, 0.8]));
        let enough: Vec<_> = (30..most).map(of).filter(|(_, found)| found[0].met >= 0.9).collect();
        let least = enough.iter().min_by(|a, b| a.1[0].trials.total_cmp(&b.1[0].trials));
        for (rounds, found) in enough.first().into_iter().chain(least) {
            let _ = writeln!(
                out,
                "| {rate} | {rounds} | {:.3} | {:.4} | {:.1} | {:.1} |",
                found[0].met, found[0].violated, found[0].trials, found[1].trials
            );
        }
    }
    Ok(())
}

fn predictions(out: &mut String) -> Result<(), ContestError> {
    out.push_str(
        "\n## The same with predictions of a simulation\n\n2,000 runs of at most 300 trials at a rate of 0.92, by betting, which needs \
         no budget. A part of the set-ups is hard; the simulation predicts the true rate of each set-up, nothing (the same for all), or \
         the opposite. Targets: at least 20 and 35 % fewer trials at a correlation of 0.6 and 0.8, and at most 3 % more if the \
         simulation misleads. At 0.8 it is 30 %; the others are met. The last column has policies whose rate is the limit.\n\n\
         | correlation | predictions | met | mean trials | share | false answers at the limit |\n|---|---|---|---|---|---|\n",
    );
    for (correlation, hard, rates, null) in [("0.6", 0.19, [0.58, 1.0], 0.25), ("0.8", 0.12, [0.32, 1.0], 0.3)] {
        let mut alone = None;
        for (name, shown) in [("none", [0.5; 2]), ("true", rates), ("opposite", [1.0, 0.2])] {
            let (met, trials) = betting(hard, rates, shown)?;
            let alone = *alone.get_or_insert(trials);
            let (wrong, _) = betting(null, [1.0 - 0.2 / null, 1.0], shown)?;
            let _ = writeln!(
                out,
                "| {correlation} | {name} | {:.3} | {trials:.1} | {:.2} | {} |",
                met,
                trials / alone,
                percent(wrong)
            );
        }
    }
    Ok(())
}

/// The share of runs that answer "met", and the mean number of trials.
fn betting(hard: f64, rates: [f64; 2], shown: [f64; 2]) -> Result<(f64, f64), ContestError> {
    let mean = hard * shown[0] + (1.0 - hard) * shown[1];
    let (mut met, mut trials) = (0_u64, 0_u64);
    for run in 0..CONTESTS {
        let random = &mut ChaCha8Rng::seed_from_u64(run);
        let mut test = Predicted::new(0.8, mean, 0.05)?;
        for _ in 0..300 {
            let at = usize::from(unit(random) >= hard);
            trials += 1;
            if test.trial(unit(random) < rates[at], shown[at])? != Answer::Open {
                break;
            }
        }
        met += u64::from(test.answer() == Answer::Met);
    }
    Ok((met as f64 / CONTESTS as f64, trials as f64 / CONTESTS as f64))
}

fn percent(share: f64) -> String {
    format!("{:.1} %", 100.0 * share)
}

fn unit(random: &mut ChaCha8Rng) -> f64 {
    ((random.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
}
