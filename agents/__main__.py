from hedgerow.agents.command import main

main()
