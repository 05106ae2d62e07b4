"""Ways of proving something about an error system: one method one file or folder, each an object that is its
certificate."""
