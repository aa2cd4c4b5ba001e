"""Motions, rates and sensors for which nothing was tuned: each drive runs through the algorithms in
one process (zloam-offline) and is judged against its exact truth."""
