"""Room acoustics on plain arrays: image sources, fractional delays, rendering along a path, reverberation."""
