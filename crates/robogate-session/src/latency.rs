//! The inference latency of a policy.

use std::str::FromStr;
use std::time::Instant;

use anyhow::{anyhow, bail};
use robogate_campaign::Worker;
use robogate_core::latency::{Execution, ExecutionMode, LATENCY_PARAMETER, Latency, MOST_LATENCY_S};
use robogate_core::{Assignment, Domain, Fault, Parameter, ParameterSpace, Scale, Scenario, Seed, TaskSpec};

use crate::duration;
use crate::notice::note;
use crate::stress::{self, StressChoice};

/// Requests whose latency is measured, after one that is not.
const MEASURED: usize = 30;

/// Latency and execution as the user chooses them.
#[derive(Debug, Clone, Default)]
pub struct LatencyChoice {
    /// The latency. `None` if the world waits for the policy.
    pub latency: Option<WantedLatency>,
    /// What the robot does while the policy computes. `None` for the default.
    pub execution: Option<ExecutionMode>,
    /// What else varies between environment and policy.
    pub stress: StressChoice,
}

/// A latency as the user gives it.
#[derive(Debug, Clone, PartialEq)]
pub enum WantedLatency {
    /// A distribution.
    Given(Latency),
    /// Measured before the run.
    Measured,
    /// Set by the parameter of the scenario. With a range, the parameter is added to the space.
    Varied(Option<[f64; 2]>),
}

impl FromStr for WantedLatency {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        parse(text)
    }
}

fn parse(text: &str) -> Result<WantedLatency, String> {
    let (kind, numbers) = text.split_once(':').unwrap_or((text, ""));
    let numbers: Vec<f64> = match numbers {
        "" => Vec::new(),
        numbers => numbers.split(',').map(duration::seconds).collect::<Result<_, _>>()?,
    };
    let wanted = match (kind, &*numbers) {
        ("measured", []) => WantedLatency::Measured,
        ("varied", []) => WantedLatency::Varied(None),
        ("varied", [low, high]) if low < high && *high <= MOST_LATENCY_S => WantedLatency::Varied(Some([*low, *high])),
        ("fixed", [seconds]) => WantedLatency::Given(Latency::Fixed { seconds: *seconds }),
        ("uniform", [low_s, high_s]) => WantedLatency::Given(Latency::Uniform { low_s: *low_s, high_s: *high_s }),
        ("normal", [mean_s, sd_s]) => WantedLatency::Given(Latency::Normal { mean_s: *mean_s, sd_s: *sd_s }),
        ("gamma", [mean_s, sd_s]) => WantedLatency::Given(Latency::Gamma { mean_s: *mean_s, sd_s: *sd_s }),
        _ => {
            return Err(format!(
                "`{text}` is not a valid latency. Expected fixed:80ms, uniform:50ms,150ms, normal:80ms,10ms, \
                 gamma:80ms,20ms, measured, varied or varied:0ms,500ms (at most {MOST_LATENCY_S} s)"
            ));
        }
    };
    if let WantedLatency::Given(latency) = &wanted {
        latency.check().map_err(|why| why.to_string())?;
    }
    Ok(wanted)
}

/// Reads an execution mode: `hold`, `queue` or `overlap`.
pub fn execution_mode(text: &str) -> Result<ExecutionMode, String> {
    match text {
        "hold" => Ok(ExecutionMode::Hold),
        "queue" => Ok(ExecutionMode::Queue),
        "overlap" => Ok(ExecutionMode::Overlap),
        _ => Err(format!("`{text}` is not an execution mode. Expected hold, queue or overlap")),
    }
}

impl LatencyChoice {
    /// The latency and execution of this choice. `None` if the world waits for the policy. `worker` creates a worker
    /// without latency, whose policy is measured if the user wants that.
    pub fn execution(&self, worker: impl FnOnce() -> Result<Worker, Fault>) -> anyhow::Result<Option<Execution>> {
        let mode = self.execution.unwrap_or_default();
        let latency = match (&self.latency, self.execution) {
            (None, None) => return Ok(None),
            (None, Some(_)) => Latency::Fixed { seconds: 0.0 },
            (Some(WantedLatency::Given(latency)), _) => latency.clone(),
            (Some(WantedLatency::Varied(_)), _) => Latency::Parameter,
            (Some(WantedLatency::Measured), _) => {
                let mut samples_s =
                    measure(worker().map_err(|fault| anyhow!(fault))?).map_err(|fault| anyhow!(fault))?;
                let latency = Latency::Measured { samples_s: samples_s.clone() };
                latency.check()?;
                samples_s.sort_by(f64::total_cmp);
                let ms = |share: f64| 1e3 * samples_s[(share * (MEASURED - 1) as f64).round() as usize];
                note(format_args!(
                    "measured latency of {MEASURED} requests: median {:.3} ms, largest {:.3} ms",
                    ms(0.5),
                    ms(1.0)
                ));
                latency
            }
        };
        Ok(Some(Execution { latency, mode }))
    }

    /// The space with the parameters of this choice for this task: those of the stress, and the latency if it varies over a range.
    pub fn added_to(&self, space: ParameterSpace, task: &TaskSpec) -> anyhow::Result<ParameterSpace> {
        let space = match self.stress.stress()? {
            Some(stress) => stress::with_parameters(space, &stress, task)?,
            None => space,
        };
        self.with_latency(space)
    }

    fn with_latency(&self, space: ParameterSpace) -> anyhow::Result<ParameterSpace> {
        let range = match &self.latency {
            Some(WantedLatency::Varied(range)) => range,
            _ => return Ok(space),
        };
        match (range, space.position(LATENCY_PARAMETER)) {
            (None, Some(_)) => Ok(space),
            (None, None) => bail!(
                "--latency varied: the space {} has no parameter `{LATENCY_PARAMETER}`\nHint: give a range, for example \
                 --latency varied:0ms,500ms",
                space.name()
            ),
            (Some(_), Some(_)) => bail!(
                "--latency varied: the space {} has the parameter `{LATENCY_PARAMETER}` already\nHint: use --latency \
                 varied, without a range",
                space.name()
            ),
            (Some([low, high]), None) => {
                let mut parameters = space.parameters().to_vec();
                let domain = Domain::Continuous { low: *low, high: *high, scale: Scale::Linear };
                parameters.push(Parameter { name: LATENCY_PARAMETER.into(), domain });
                let name = format!("{} with latency", space.name());
                Ok(ParameterSpace::new(name, parameters)?.with_correlations(space.correlations().to_vec())?)
            }
        }
    }

    /// The same choice, with the latency set by the parameter if `space` has it and no latency is given.
    pub fn varied_by(&self, space: &ParameterSpace) -> Self {
        match space.position(LATENCY_PARAMETER) {
            Some(_) if self.latency.is_none() => Self { latency: Some(WantedLatency::Varied(None)), ..self.clone() },
            _ => self.clone(),
        }
    }

    /// The same choice for scenarios of units that have these parameters: their latency is not varied again.
    pub fn beside(&self, units: &ParameterSpace) -> Self {
        let latency = self.latency.clone().filter(|_| units.position(LATENCY_PARAMETER).is_none());
        Self { latency, ..self.clone() }
    }

    /// Rejects a range for a suite, whose scenarios are fixed.
    pub fn check_suite(&self, space: &ParameterSpace) -> anyhow::Result<()> {
        match &self.latency {
            Some(WantedLatency::Varied(Some(_))) => bail!(
                "--latency varied: the scenarios of a suite are fixed\nHint: use --latency varied with a suite that has \
                 the parameter `{LATENCY_PARAMETER}`, or a space"
            ),
            Some(WantedLatency::Varied(None)) => self.with_latency(space.clone()).map(drop),
            _ => Ok(()),
        }?;
        let stress = self.stress.stress()?;
        let lacking = stress.iter().flat_map(|stress| &stress.parameters).find(|name| space.position(name).is_none());
        if let Some(lacking) = lacking {
            bail!(
                "--stress: the scenarios of a suite are fixed, and these have no parameter `{lacking}`\nHint: choose a space with \
                 --space, or name the parameters of the suite"
            );
        }
        Ok(())
    }
}

/// The latency and execution of a run in one line.
pub fn describe(execution: &Execution) -> String {
    let ms = |seconds: f64| format!("{:.4} ms", 1e3 * seconds).replace(".0000", "");
    let latency = match &execution.latency {
        Latency::Fixed { seconds } => ms(*seconds),
        Latency::Uniform { low_s, high_s } => format!("uniform from {} to {}", ms(*low_s), ms(*high_s)),
        Latency::Normal { mean_s, sd_s } => format!("normal, {} +- {}", ms(*mean_s), ms(*sd_s)),
        Latency::Gamma { mean_s, sd_s } => format!("gamma, {} +- {}", ms(*mean_s), ms(*sd_s)),
        Latency::Measured { samples_s } => format!("as measured in {} requests", samples_s.len()),
        Latency::Parameter => format!("set by the parameter {LATENCY_PARAMETER}"),
    };
    let mode = match execution.mode {
        ExecutionMode::Hold => "the robot holds its position meanwhile",
        ExecutionMode::Queue => "the robot executes a queue of actions meanwhile",
        ExecutionMode::Overlap => "the robot executes overlapping chunks meanwhile",
    };
    format!("inference latency {latency}; {mode}")
}

/// Measures the latency of the policy in the first state of the nominal scenario, in seconds.
fn measure(mut worker: Worker) -> Result<Vec<f64>, Fault> {
    let Worker { environment, policy } = &mut worker;
    let seed = Seed::campaign(0).episode(0);
    let start = environment.reset(&Scenario { index: 0, seed, requested: Assignment::default() })?;
    let mut samples = Vec::with_capacity(MEASURED);
    policy.reset(environment.task(), &start.instance, seed)?;
    let mut observation = start.observation;
    if policy.wants_images() {
        observation.images = environment.render()?;
    }
    // The first request may load or compile the model.
    policy.predict(&observation)?;
    for _ in 0..MEASURED {
        let begin = Instant::now();
        policy.predict(&observation)?;
        samples.push(begin.elapsed().as_secs_f64());
    }
    Ok(samples)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::subject::remaining;

    #[test]
    fn latencies_are_parsed() {
        let given = |latency| Ok(WantedLatency::Given(latency));
        assert_eq!(parse("fixed:80ms"), given(Latency::Fixed { seconds: 0.08 }));
        assert_eq!(parse("uniform:50ms,0.15s"), given(Latency::Uniform { low_s: 0.05, high_s: 0.15 }));
        assert_eq!(parse("varied:0ms,500ms"), Ok(WantedLatency::Varied(Some([0.0, 0.5]))));
        assert_eq!(
            (parse("varied"), parse("measured")),
            (Ok(WantedLatency::Varied(None)), Ok(WantedLatency::Measured))
        );
        for wrong in ["80ms", "fixed", "fixed:80", "fixed:11s", "normal:80ms", "gamma:80ms,0ms", "varied:2s,1s"] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn latency_is_an_ordinary_parameter() {
        let space = crate::subject::named_space("learned").unwrap();
        let latency = Some(WantedLatency::Varied(Some([0.0, 0.5])));
        let arguments = LatencyChoice { latency, ..LatencyChoice::default() };
        let varied = arguments.with_latency(space.clone()).unwrap();
        assert_eq!(varied.len(), space.len() + 1);
        assert!(arguments.with_latency(varied.clone()).is_err());
        let rest = remaining(&varied, |name| name == LATENCY_PARAMETER).unwrap().unwrap();
        assert_eq!(rest.parameters(), space.parameters());
    }
}
