"""Reports and figures: what people read. The only package that formats numbers, and draws."""
