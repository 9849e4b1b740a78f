"""Pictures of a sweep's store: heat maps, quantile bands, maps of the best law, and regret."""
