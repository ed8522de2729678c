"""The vehicle and its parameters; serves the paper's sections Control-Oriented Model and Simulation Environment."""
