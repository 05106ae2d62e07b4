"""The spec's front door: YAML text to a Spec, every mistake with its line and column."""
