from .sweeps import computer_tasks as computer_tasks, worth_their_time as worth_their_time
