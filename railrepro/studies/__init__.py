"""Many runs: tuning, experiments, robustness, speed; serves the paper's section Multi-Body Simulation Results."""
