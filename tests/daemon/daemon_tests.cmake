find_package(rapidcheck REQUIRED)
celadon_test(daemon_tests
  SOURCES profile_log_test.cpp
  LINK celadon::daemon rapidcheck
  LABELS threads)
