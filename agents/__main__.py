from hedgerow.agents.process import main

main()
