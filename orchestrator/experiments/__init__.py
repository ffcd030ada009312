"""Many runs: sweeps, random faults, long runs."""
