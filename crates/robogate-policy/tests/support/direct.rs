//! Profiles without the lag of LIBERO's controller.

/// A profile for LIBERO whose motions are executed directly, without the lag of LIBERO's controller: 0.02 m and 0.05 rad
/// for an action of 1, upright images, and positions in the base frame.
pub(crate) fn direct(text: &str) -> String {
    let changes = [
        ("arm = \"osc_pose\"", "arm = \"tool_delta\""),
        ("position_scale_m = 0.05", "position_scale_m = 0.02"),
        ("rotation_scale_rad = 0.5", "rotation_scale_rad = 0.05"),
        ("orientation = \"mirrored\"\n", ""),
        ("shift_m = [-0.66, 0.0, 0.912]\n", ""),
    ];
    changes.iter().fold(text.to_owned(), |text, (from, to)| text.replace(from, to))
}
