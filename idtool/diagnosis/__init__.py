"""Where a model and its logs disagree, which effect explains it, and how far the gap shrinks once it is there."""
