"""Controllers of this project without counterpart in the paper: LqgPreview with its model, and slip control."""
