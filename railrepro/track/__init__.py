"""The track and what is laid along it; serves the paper's sections Train-Track Interaction and Test Tracks."""
