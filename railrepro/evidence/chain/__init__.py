"""The chain of notebooks and its products; serves no section of the paper but the rerun of all of them."""
