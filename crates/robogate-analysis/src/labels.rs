//! Labels of parameters and failure modes in reports.

/// Units at the end of parameter names, and their notation.
const UNITS: [(&str, &str); 15] = [
    ("_nms_rad", "N·m·s/rad"),
    ("_m_s2", "m/s²"),
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_kg", "kg"),
    ("_mm", "mm"),
    ("_rad", "rad"),
    ("_deg", "°"),
    ("_m", "m"),
    ("_nm", "N·m"),
    ("_n", "N"),
    ("_lux", "lx"),
    ("_hz", "Hz"),
    ("_s", "s"),
    ("_j", "J"),
];

/// The label of a parameter (its name without the unit, with spaces for underscores) and its unit, which may be empty.
pub fn label_and_unit(parameter: &str) -> (String, &'static str) {
    let (stem, unit) = UNITS
        .iter()
        .find_map(|(ending, unit)| {
            parameter.strip_suffix(ending).filter(|stem| !stem.is_empty()).map(|stem| (stem, *unit))
        })
        .unwrap_or((parameter, ""));
    let words: Vec<String> = stem
        .split('_')
        .map(|word| match word {
            "ik" | "com" => word.to_ascii_uppercase(),
            _ => word.to_owned(),
        })
        .collect();
    (words.join(" "), unit)
}

/// The label of a parameter, or of one of its levels: "friction", "shape sphere".
pub fn parameter_or_level(parameter: &str, level: Option<&str>) -> String {
    match level {
        Some(level) => format!("{} {}", parameter_label(parameter), mode_label(level)),
        None => parameter_label(parameter),
    }
}

/// The label of a parameter: "mass" for `mass_kg`.
pub fn parameter_label(parameter: &str) -> String {
    label_and_unit(parameter).0
}

/// The label of a parameter with its unit: "mass (kg)" for `mass_kg`.
pub fn label_with_unit(parameter: &str) -> String {
    match label_and_unit(parameter) {
        (label, "") => label,
        (label, unit) => format!("{label} ({unit})"),
    }
}

/// A value with the unit of its parameter: "0.34 kg".
pub fn value_with_unit(value: &str, parameter: &str) -> String {
    match label_and_unit(parameter).1 {
        "" => value.to_owned(),
        unit => format!("{value} {unit}"),
    }
}

/// The label of a failure mode or another identifier: "grasp miss" for `grasp_miss`.
pub fn mode_label(mode: &str) -> String {
    mode.replace('_', " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_drop_the_unit() {
        assert_eq!(label_and_unit("mass_kg"), ("mass".to_owned(), "kg"));
        assert_eq!(label_and_unit("ik_noise_rad"), ("IK noise".to_owned(), "rad"));
        assert_eq!(label_and_unit("friction"), ("friction".to_owned(), ""));
        assert_eq!(label_and_unit("m"), ("m".to_owned(), ""));
    }
}
