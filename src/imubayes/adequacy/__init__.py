"""Whether a fit is adequate by itself: its noise against what is known of it, and its runs against one another."""
