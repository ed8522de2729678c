"""How results depend on what the paper does not publish: robustness, stability margins, limits with sensors."""
