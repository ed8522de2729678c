"""Experiments (closed-loop runs and their metrics), their parallel execution and storage, and tuning by swarms."""
