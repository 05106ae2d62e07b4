"""Mathematics that serves several families. Reads a HybridInclusion or plain matrices, knows no family."""
