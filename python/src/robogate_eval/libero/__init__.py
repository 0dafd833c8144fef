"""LIBERO (Liu et al. 2023): 40 manipulation tasks in four suites, as environments. It uses the user's installation of LIBERO."""
