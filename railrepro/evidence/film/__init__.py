"""Films of runs, two controllers side by side: what a film shows, its page, its movie; and interactive parameters."""
