"""Controllers of this project without counterpart in the paper: CreepMPC with its model, and slip control."""
