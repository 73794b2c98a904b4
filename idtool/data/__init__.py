"""What was recorded: logs, what is wrong with them, and the motion and torque that they give."""
