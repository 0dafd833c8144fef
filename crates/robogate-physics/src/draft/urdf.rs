//! What MuJoCo does not say about a URDF.

/// A limit of a joint beyond this angle is likely in degrees, in radians: two turns.
const MANY_TURNS: f64 = 4.0 * std::f64::consts::PI;

/// The velocity limit of a joint, in rad/s. MuJoCo does not read it.
pub(super) fn velocity(text: &str, joint: &str) -> Option<f64> {
    let element = elements(text, "joint").find(|element| attribute(element, "name") == Some(joint))?;
    number(limit(element), "velocity").filter(|speed| *speed > 0.0 && speed.is_finite())
}

/// What the model does not state and MuJoCo fills in, and what is likely in another unit.
pub(super) fn guesses(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let links: Vec<&str> = elements(text, "link")
        .filter(|element| element.contains("<collision") && !element.contains("<inertial"))
        .filter_map(|element| attribute(element, "name"))
        .collect();
    if !links.is_empty() {
        found.push(format!(
            "masses of {}: these links have no <inertial>, so each is the volume of its shapes times 1,000 kg/m3",
            links.join(", ")
        ));
    }
    for joint in elements(text, "joint").filter(|element| attribute(element, "type") == Some("revolute")) {
        let ends = ["lower", "upper"].map(|end| number(limit(joint), end));
        if let (Some(name), [Some(low), Some(high)]) = (attribute(joint, "name"), ends)
            && low.abs().max(high.abs()) > MANY_TURNS
        {
            found.push(format!("limits of `{name}`: {low} to {high} rad are many turns. Are they degrees?"));
        }
    }
    found
}

/// The elements of a document with this name, up to their end or, if they have none, to the end of the document.
fn elements<'a>(text: &'a str, name: &'a str) -> impl Iterator<Item = &'a str> {
    let (start, end) = (format!("<{name}"), format!("</{name}>"));
    let starts: Vec<usize> = text.match_indices(&start).map(|(at, _)| at).collect();
    starts.into_iter().filter_map(move |at| {
        let rest = &text[at..];
        rest[start.len()..].starts_with(char::is_whitespace).then(|| rest.split(&end).next().unwrap_or(rest))
    })
}

/// The limit of a joint, empty without one.
fn limit(joint: &str) -> &str {
    joint.split("<limit").nth(1).and_then(|rest| rest.split('>').next()).unwrap_or_default()
}

/// The first attribute of this name as a number.
fn number(element: &str, name: &str) -> Option<f64> {
    attribute(element, name)?.trim().parse().ok()
}

/// The first attribute of this name.
fn attribute<'a>(element: &'a str, name: &str) -> Option<&'a str> {
    let value = element.match_indices(name).find_map(|(at, _)| {
        let after = element[at + name.len()..].trim_start().strip_prefix('=')?.trim_start();
        element[..at].ends_with(char::is_whitespace).then_some(after)
    })?;
    let quote = value.chars().next().filter(|quote| "\"'".contains(*quote))?;
    value[1..].split(quote).next()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_stated_is_named() {
        let text = r#"<robot name="r">
          <link name="base"><inertial><mass value="1"/></inertial><collision/></link>
          <link name='upper'><collision><geometry><box size="1 1 1"/></geometry></collision></link>
          <link name="frame"/>
          <joint name="a" type="revolute"><limit lower="-170" upper="170" effort="1" velocity="2.5"/></joint>
          <joint name="b" type="revolute"><limit lower="-3.1" upper="6.2"/></joint>
          <joint name="c" type="continuous"><limit lower="-99" upper="99"/></joint>
        </robot>"#;
        let found = guesses(text);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found[0].starts_with("masses of upper: ") && found[1].contains("`a`: -170 to 170 rad"), "{found:?}");
        assert_eq!((velocity(text, "a"), velocity(text, "b")), (Some(2.5), None));
        assert_eq!(guesses("<link"), [""; 0]);
        assert_eq!(guesses("<link <joint type=\"revolute\" <limit lower="), [""; 0]);
    }
}
