"""What a calibration can know: sweeps, profiles, posterior, sensitivity, equivalents, design."""
