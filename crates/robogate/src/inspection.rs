//! The result of a robot check, in the terminal and as JSON.

use robogate_physics::{Grasp, RobotSettings};
use robogate_tasks::pick_place::{Inspection, Measured, TrialEpisode, inspect};
use serde_json::json;

use crate::commands::robots::{facts, in_words};
use crate::exit::{DONE, USAGE};
use crate::terminal::{bold, line, percent};

/// Checks a robot, prints the result and returns the exit code.
pub(crate) fn show(robot: &str, json: bool) -> u8 {
    let inspection = inspect(robot);
    let Inspection { problems, settings, measured } = &inspection;
    if json {
        line(json!({
            "version": 1,
            "robot": settings.as_ref().map(facts),
            "problems": problems,
            "measured": measured,
        }));
    } else {
        let name = settings.as_ref().map_or(robot, |settings| &settings.name);
        match problems.len() {
            0 => line(format_args!("{} {name} can be used", bold("ok"))),
            1 => line(format_args!("{} 1 problem with {name}", bold("FAILS"))),
            n => line(format_args!("{} {n} problems with {name}", bold("FAILS"))),
        }
        for (i, problem) in problems.iter().enumerate() {
            line(format_args!("\n{}. {}\nHint: {}", i + 1, problem.what, problem.hint));
        }
        if let (Some(settings), Some(measured)) = (settings, measured) {
            line("");
            summary(settings, measured);
        }
    }
    if problems.is_empty() { DONE } else { USAGE }
}

fn summary(settings: &RobotSettings, Measured { robot: measured, reaches_target, episode }: &Measured) {
    let RobotSettings { arm, gripper, .. } = settings;
    let total: f64 = measured.masses_kg.iter().map(|(_, mass)| mass).sum();
    let masses: Vec<String> = measured.masses_kg.iter().map(|(body, mass)| format!("{body} {mass:.3}")).collect();
    line(format_args!("joints     {}: {}", arm.joints.len(), arm.joints.join(", ")));
    line(format_args!("gripper    {}", in_words(gripper)));
    line(format_args!("masses     {total:.3} kg of moving links: {}", masses.join(", ")));
    line(format_args!(
        "reach      {:.3} m declared; measured from the axis of the first joint: flange {:.3} m, tool {:.3} m",
        arm.reach_m, measured.flange_reach_m, measured.tool_reach_m
    ));
    line(format_args!(
        "workspace  {} of the positions over the table can be reached with the tool pointing down; target {}",
        percent(measured.workspace_share),
        if *reaches_target { "reachable" } else { "out of reach" }
    ));
    if !reaches_target {
        line("           while the target is out of reach, no episode can succeed");
    }
    match measured.tracking_error_rad {
        Some(error) => line(format_args!("servos     hold and track within {:.2} mrad", 1e3 * error)),
        None => line("servos     not tested: see the problems above"),
    }
    match &measured.grasp {
        Some(grasp) => {
            line(format_args!("grasp      {}", in_sentence(grasp)));
            let held = measured.grasps_at_ends.iter().filter(|grasp| grasp.held);
            let parts: Vec<String> =
                held.map(|grasp| format!("{:.0} mm and {:.2} kg", 1e3 * grasp.part_m, grasp.mass_kg)).collect();
            if !parts.is_empty() {
                line(format_args!("           also holds parts of {}", parts.join(", ")));
            }
        }
        None => {
            line("grasp      not tested: see the problems above, or the arm cannot lift a part from its home posture")
        }
    }
    match episode {
        Some(TrialEpisode { part_m, mass_kg, failure, time_s }) => {
            let ending = failure.as_ref().map_or("success", |failure| failure.as_str());
            line(format_args!(
                "episode    pick and place with a part of {:.0} mm and {mass_kg:.2} kg: {ending} after {time_s:.1} s",
                1e3 * part_m
            ));
        }
        None if !reaches_target => line("episode    not tried: the target is out of reach"),
        None => line("episode    not tried: see the problems above"),
    }
}

/// The test grasp in one sentence.
fn in_sentence(grasp: &Grasp) -> String {
    let Grasp { opening_m, part_m, mass_kg, force_n, slip_m, held } = grasp;
    let opens = opening_m.map_or_else(String::new, |opening| format!("opens {:.1} mm; ", 1e3 * opening));
    let part = format!("a part of {:.0} mm and {mass_kg:.2} kg", 1e3 * part_m);
    let force = force_n.map_or_else(String::new, |force| format!(" with {force:.1} N on each pad"));
    match held {
        true => format!("{opens}holds {part}{force}; it moved by {:.2} mm in the gripper", 1e3 * slip_m),
        false => format!("{opens}loses {part}"),
    }
}
