"""How far a result depends on what the paper does not publish: robustness, margins."""
