"""Motions, rates and sensors that nobody tuned for: each drive through the algorithms in one
process (zloam-offline), judged against its exact truth."""
