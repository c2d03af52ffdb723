find_package(rapidcheck REQUIRED)
celadon_test(daemon_tests
  SOURCES button_test.cpp calibration_due_test.cpp calibration_queue_test.cpp calibration_request_test.cpp fake_machine.cpp laser_agreement_test.cpp late_frames_test.cpp lease_history_test.cpp partial_sums_test.cpp profile_log_test.cpp results_test.cpp scan_exposure_test.cpp scan_fault_test.cpp scan_axes_test.cpp scan_job_test.cpp scan_lasers_test.cpp scan_queue_test.cpp scan_request_test.cpp scan_stops_test.cpp side_camera_test.cpp stop_plan_test.cpp thread_executor_test.cpp
          sim_control_test.cpp
  APART button_test.cpp partial_sums_test.cpp scan_axes_test.cpp scan_exposure_test.cpp side_camera_test.cpp
  LINK celadon::calibration_session celadon::daemon celadon::controller_core rapidcheck
  LABELS threads)
