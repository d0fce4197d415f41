from .sweeps import computer_tasks as computer_tasks, measured as measured, worth_their_time as worth_their_time
