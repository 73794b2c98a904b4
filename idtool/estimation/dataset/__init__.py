"""Robot and logs put together, and reduced to triangular factors."""
