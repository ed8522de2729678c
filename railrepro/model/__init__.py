"""The model that the controllers predict with, and its forecast; serves the paper's section Control-Oriented Model."""
