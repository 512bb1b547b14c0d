"""What is done again and again: lost work found, webhooks told, garbage collected."""
