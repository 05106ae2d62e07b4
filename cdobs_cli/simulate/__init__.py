"""Plant and observer run together: flow, jump, next sample. Knows no family."""
