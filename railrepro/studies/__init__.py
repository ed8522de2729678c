"""Studies: many runs side by side, executed in parallel, stored, compared and drawn."""
