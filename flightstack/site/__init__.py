"""Where a vehicle may be: sites, their files, and the filter that keeps a vehicle in one (docs/site.md)."""
