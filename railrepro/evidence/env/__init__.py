"""The car as an environment for learning controllers, with the interface of Gymnasium (extra `learn`)."""
