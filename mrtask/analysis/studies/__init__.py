"""Studies beyond a single run: ablation, sensitivity, priors, realism and calibration."""
