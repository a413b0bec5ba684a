"""Runs the shards of a boresight dataset, or any command over a list, on one machine or on many. See README.md."""

__version__ = "0.1.0"
