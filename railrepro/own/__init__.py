"""Controller of this project without counterpart in the paper: LqgPreview, and its model of a running gear."""
