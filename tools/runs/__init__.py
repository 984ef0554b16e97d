"""What every long command shares: workers, results that are kept, and what signals and failures mean."""
