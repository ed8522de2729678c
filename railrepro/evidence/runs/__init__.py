"""Many runs: experiments, where they are computed, particle swarms and the tuned sets that they find."""
