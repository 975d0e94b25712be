"""Communication between the ranks of a distributed mesh."""
