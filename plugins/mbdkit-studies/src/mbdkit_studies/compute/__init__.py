"""How the points of a study are computed: plan, tasks, pools and executors."""
