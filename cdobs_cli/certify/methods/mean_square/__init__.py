"""How large errors stay in mean square: under white noise and disturbance, or in power under bounded ones."""
