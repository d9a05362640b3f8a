"""Data only: scenes, studies, pipelines (presets), reference values and licensed sound clips."""
