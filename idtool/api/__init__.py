"""What `import idtool` offers: logs, models, and what the commands do as functions. One file here a noun or a verb."""
