"""Measurement for the controllers: sensors with noise, bias and latency, and the filter that estimates states."""
