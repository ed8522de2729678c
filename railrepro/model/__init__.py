"""The model with which the controllers predict, and its forecast of the track ahead."""
