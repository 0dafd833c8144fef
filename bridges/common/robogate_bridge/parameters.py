"""The parameters of RoboGate's cell that an engine applies. Generated from the parameter table."""

PARAMETERS = [
    "friction",
    "mass_kg",
    "com_offset",
    "size_m",
    "obstacles",
    "shape",
    "placement",
    "table_friction",
    "position_jitter_m",
    "gravity_scale",
    "offset_x_m",
    "offset_y_m",
    "obstacle_gap_m",
    "occluders",
    "disturbance_speed_m_s",
    "disturbance_start_s",
    "disturbance_x_m",
    "disturbance_y_m",
    "disturbance_heading_rad",
    "disturbance_travel_m",
]
