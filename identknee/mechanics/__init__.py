"""The kernel, arrays in, arrays out: contact, ligaments, equilibrium, sensitivities."""
