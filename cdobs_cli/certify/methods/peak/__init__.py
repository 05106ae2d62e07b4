"""How large the error stays under bounded disturbance and noise: chains of clock-dependent quadratic functions."""
