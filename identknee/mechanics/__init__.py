"""The kernel: arrays in, arrays out; signed distance, contact, ligaments, equilibrium, sensitivities."""
