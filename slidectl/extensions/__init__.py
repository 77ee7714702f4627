"""Parts beside the spine: each uses public faces only, and no other extension but for those that a test names."""
