"""The open benchmark: a controller of one's own, or a registered one, through one suite of runs to a score card."""
