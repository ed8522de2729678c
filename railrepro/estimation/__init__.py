"""What a controller gets to see: sensors with noise, bias and latency, and the filter that makes states of them."""
