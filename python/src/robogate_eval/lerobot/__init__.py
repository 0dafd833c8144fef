"""LeRobot: its environments, and its policies from checkpoint folders, in the Python of the user's LeRobot."""
