"""Adaptive process noise: detection of water and sensors that do not behave as their models say."""
