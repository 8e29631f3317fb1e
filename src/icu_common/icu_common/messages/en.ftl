# English sentences of the graph's programs, for logs, terminals and the operator page. The key is the code with `-` for
# the dot. The format is Fluent (https://projectfluent.org/fluent/guide); core/reasons/catalogue.py lists the parts in use.

## alignment

alignment-cameras_not_compared_limit_both = the last comparison of the cameras is { $age_s } s old (limit { $limit_s } s): do both see the panel?
alignment-degrees = { $turn_deg } degrees ({ $turn_px } px)
alignment-right_above_layout_limit_correct = { $control } is { $x_mm } mm right of and { $y_mm } mm above its layout (limit { $limit_mm } mm): correct the layout
alignment-right_camera_moved_limit_degrees = the right camera has moved by { $turn } (limit { $limit_deg } degrees): calibrate again
alignment-right_camera_moving_calibration_not = the right camera is moving: { $turn } from its calibration, and not at rest
alignment-touch_known_limit = the uncertainty of the touch is { $uncertainty_mm } mm (limit { $limit_mm } mm)

## axes

axes-axes_miss_right_angle_degrees = the axes miss a right angle by { FIXED($degrees_deg, digits: 1) } degrees (limit { FIXED($degrees, digits: 1) })
axes-axis_moves_per_metre_reading = the { $name } axis moves { FIXED($scale_m, digits: 3) } m per metre of reading (limits { FIXED($max_scale_error, digits: 2) } to { FIXED($max_scale_error_2, digits: 2) }): check steps per mm and the camera calibration
axes-not_go_they_should_one = x and y move in wrong directions: one runs backwards, or both have changed places. Move each a little and look which it is, before you change motors or settings
axes-stylus_leans_degrees_plausible_add = the stylus leans by { FIXED($degrees_deg, digits: 1) } degrees (limit { FIXED($degrees, digits: 1) }): add samples with the stylus further in and out
axes-stylus_moves_towards_panel_per = the stylus moves { FIXED($depth_m, digits: 3) } m towards the panel per metre of extension (limits { FIXED($max_scale_error, digits: 2) } to { FIXED($max_scale_error_2, digits: 2) }): check its steps per mm, or add samples with the stylus further in and out
axes-stylus_not_go_they_should = stylus, x and y move in wrong directions: x or y runs backwards, both have changed places, or the stylus rises when it should sink. Move each a little and look which it is, before you change motors or settings

## board

board-lines_unanswered = { $reason }; { $lost ->
    [one] { $lost } line unanswered
   *[other] { $lost } lines unanswered
}
board-board_answered_out_turn_line = the board answered $G out of turn: the serial line has lost or doubled a line or an answer
board-board_holds_bytes_under_way = the board holds { $held } bytes, but only { $in_flight_bytes } are in transit: an answer came that belongs to no line
board-board_reports_tell_no_machine = the board's reports have no machine position: ${ $report_mask } is { $value }, set its bit 0 ({ $machine_position })
board-board_reset_itself_more_times = the board has reset itself { $more } more times within { FIXED($within_s, digits: 1) } s
board-board_taken_lines_not_answered = the board has not answered some lines that it accepted: the serial line has lost a line or its answer
board-cannot_read = { $text }: cannot read { $decode }
board-no_answer_within_although_board = no answer to { $line } within { SHORT($answer_within_s) } s although the board is at rest

## bridge

bridge-no_driver_listens = no driver is running
bridge-no_recognition_listens_could_taught = no recognition is running that can learn a panel
bridge-no_report_late = no report for { FIXED($silent_s, digits: 0) } s, late: { $names }
bridge-no_sequencer_listens = no sequencer is running
bridge-record_could_not_written = cannot write the record: { $error }
bridge-reset_void = no reset, the machine has another state now: { $state }
bridge-reset_waits = waits until the stop is complete and the stylus is up
bridge-service_not = the service { $services } is missing
bridge-stop_by_person = stop: stopped_by_person, pressed by { $who }
bridge-stop_cause = stop: { $cause }
bridge-stop_silent = stop: { $cause }, silent for { FIXED($silence_s, digits: 2) } s (limit { FIXED($limit_s, digits: 2) } s)
bridge-stopped_before_went_out = stopped before it went out

## calibration

calibration-part_with_note = { $done }/{ $total }, { FIXED($remaining_s, digits: 0) } s left ({ $note })
calibration-part = { $done }/{ $total }, { FIXED($remaining_s, digits: 0) } s left
calibration-failed = calibration failed: { $reason }
calibration-drifted = { $summary }; drift: { $drift }
calibration-progress = calibrating { $reason }
calibration-already_solve = there are { $max_contacts } already; solve
calibration-base_reading_cannot_inverted = base_from_reading { $axes } has no inverse
calibration-below_0 = { $key } = { $document } is below 0
calibration-calibrating_watch_state = calibrating; watch the state
calibration-calibration_already_running = a calibration is already running
calibration-calibration_could_not_saved = cannot save the calibration: { $error }
calibration-calibration_file_not_set = no calibration_file
calibration-calibration_running = a calibration is running
calibration-calibration_use_refused = the calibration in use does not fit: { $why }
calibration-camera_calibration_changed_meanwhile = the { $side } camera's calibration has changed meanwhile
calibration-camera_calibration_changed_since_made = the { $name } camera's calibration has changed by { FIXED($change_px, digits: 2) } px since this calibration
calibration-camera_info = camera_info: { $error }
calibration-camera_pictures_no_calibration = the { $side } camera's images of { $width } x { $height_px } px have no calibration
calibration-cameras_carriage = , cameras on the carriage
calibration-driver_says = the driver reports { $text }
calibration-driver_says_connected_homed_idle = the driver reports { $driver }; expected connected, homed and idle
calibration-finite_numbers_shape_needed = { $key } = { $given }; expected finite numbers of shape { $shape }
calibration-finite_point_needed = { $point } in { $frame }; expected a finite point in { $panel }
calibration-format_needed = expected format { $format }
calibration-gantry_moved_but_seen_only = the gantry moved { FIXED($along_mm, digits: 0) } mm, but the cameras saw { $what } move only { FIXED($seen_mm, digits: 1) } mm: they track another object, the camera's mounting is another, or the drive slips. Look at the picture before you move again
calibration-goal = the goal { $where } was { $outcome }: { $reason }
calibration-goal_not_within = the goal was not { $value } within { SHORT($waited_s) } s
calibration-hand_eye_node_stopped = the hand-eye node has stopped
calibration-hardly_leave_one_line = hardly leave one line
calibration-held_out = , held-out { FIXED($held_out_mm, digits: 2) } mm
calibration-held_out_place_off_accepted = at a held-out position the { $what } was { FIXED($max_mm, digits: 2) } mm off (limit { FIXED($max_held_out_mm, digits: 2) } mm)
calibration-lie_one_line = lie on one line
calibration-lowered_stylus_could_touch_panel = lowered by { FIXED($least_mm, digits: 1) } mm the stylus could touch the panel. Its tip is { FIXED($height_mm, digits: 1) } mm above it (the tallest control and the ball take { FIXED($proud_m, digits: 1) }). Move the instrument { FIXED($least_2_mm, digits: 1) } mm away, or reduce run.heights_m and held_out_height_m
calibration-lowered_tip_moved_check_stylus = lowered by { FIXED($way_mm, digits: 1) } mm the tip moved by { FIXED($seen_mm, digits: 1) } mm: check the stylus's steps per mm ($102), whether it is stuck, and the camera calibration
calibration-machine_settings_changed_since_made = the machine's settings have changed since this calibration: { $texts }
calibration-made_cameras_mounted_now = the calibration is for cameras mounted { $mounting }, now it is { $mounting_2 }
calibration-made_machine_one = the calibration is for machine { $machine }, this one is { $machine_2 }
calibration-made_picture_now = the calibration is for a { $name } image of { $width } x { $height_px } px, now it has { $width_2 } x { $height_2_px } px
calibration-mapping_needed = { $key } = { $part }; expected a mapping
calibration-missed = { $missed } missed
calibration-missing = { $key }: { $error } is missing
calibration-mounting_fixed_carriage_needed = mounting { $mounting }; expected 'fixed' or 'carriage'
calibration-no_calibration_save = there is no calibration to save
calibration-no_camera_info_camera_arrived = no camera_info of the { $side } camera has arrived
calibration-no_image_resting_machine_arrived = no image of the resting machine arrived for { FIXED($waited_s, digits: 1) } s
calibration-no_image_resting_machine_evaluated = the program has evaluated no image of the resting machine for { FIXED($waited_s, digits: 1) } s
calibration-not_hand_eye_calibration = { $path }: not a hand-eye calibration: { $error }
calibration-now = { $k } was { $old_values }, now { $new_values }
calibration-only_held_out_places_gave = only { $checks } held-out positions gave a sample (at least 2 to check the result)
calibration-panel_seen_times_while_machine = the cameras saw the panel { $poses } of { $panels } times while the machine was at rest
calibration-places_gave_no_sample_last = { $missed } of { $places } positions gave no sample; last: { $why }
calibration-readings_not_differ_gantry_did = the readings do not differ ({ FIXED($along_mm, digits: 2) } mm): the gantry did not move; move at least { FIXED($need_mm, digits: 0) } mm in x and in y
calibration-repetition = { $late }; repetition { $step } of { $retries }
calibration-run_places_not_tell_calibration = the run's positions do not determine the calibration: { $error }
calibration-sample_not_finite = a sample is not finite
calibration-sample_readings_stylus = sample { $count } at readings x = { FIXED($x, digits: 1) }, y = { FIXED($y, digits: 1) }, stylus = { FIXED($stylus_mm, digits: 1) } mm
calibration-samples_long_across_add_one = the samples { $kind } ({ FIXED($along_mm, digits: 0) } mm long, { FIXED($across_mm, digits: 1) } mm across): add one near x = { FIXED($x, digits: 0) }, y = { FIXED($y_mm, digits: 0) } mm or at least { FIXED($need_mm, digits: 0) } mm off that line
calibration-samples_miss_one_another_rms = the samples miss one another by { FIXED($rms_mm, digits: 2) } mm rms (limit { FIXED($max_rms_mm, digits: 2) } mm): check that the cameras see the tip well and that nothing slips
calibration-samples_needed_move_another_place = { $samples } samples (at least { $min_samples }): move to another position and add one
calibration-samples_not_fit_rest_numbers = { $left_out } of { $used } samples do not fit the rest (numbers { $numbers }): the cameras measured the tip wrongly there, or the drive slipped. Take samples in other positions, or start again
calibration-samples_rms_predicted = { $samples } samples{ $where }, rms { FIXED($rms_mm, digits: 3) } mm{ $held }, predicted { FIXED($sigma_mm, digits: 3) } mm, { $made_at }
calibration-samples_too_close_together_move = the samples are too close together ({ FIXED($along_mm, digits: 1) } mm): move at least { FIXED($need_mm, digits: 0) } mm in x and in y
calibration-saved = saved to { $path }
calibration-seen_too_late = the cameras saw it too late
calibration-stored_calibration_refused = the stored calibration does not fit: { $error }
calibration-stylus_extension_changes_together_own = the stylus extension changes together with x and y (own part { FIXED($ptp_mm, digits: 2) } mm): add a sample at the same x and y with the stylus { FIXED($min_stylus_span_mm, digits: 0) } mm further in or out
calibration-tip = the tip
calibration-tip_nowhere_seen_both_cameras = the two cameras never saw the tip at once. Have left and right changed places, is one upside down or out of focus, or is the ball another one? The stylus tracker's diagnostics have the details
calibration-tip_seen_times_while_machine = the cameras saw the tip { $tips } of { $tips_2 } times while the machine was at rest
calibration-translation_most_possible = translation_m = { $shift } (limit { SHORT($farthest_m) } m)
calibration-waiting_camera_info_check_calibration = waiting for camera_info to check the calibration file
calibration-whole_number_0_needed = { $key } = { $value }; expected a whole number from 0
calibration-z = x = { FIXED($x, digits: 0) }, y = { FIXED($y, digits: 0) }, z = { FIXED($z_mm, digits: 0) } mm

## carriage

carriage-contacts_1_needed = { $contacts } contacts (limits 1 to { $max_contacts })
carriage-contacts_miss_one_another_rms = the contacts miss one another by { FIXED($rms_mm, digits: 2) } mm rms (limit { FIXED($contact_sigma_mm, digits: 2) } mm): check which points the stylus touched
carriage-contacts_most_used_start_anew = { $contacts } contacts (limit { $max_contacts }): start again
carriage-nothing_tells_where_stylus_let = the position of the stylus is unknown: move its tip into the cameras' view, or touch one to five known points
carriage-only_points_panel_measured_needed = the cameras measured only { $pixels } points of the panel at x = { FIXED($reading, digits: 0) }, y = { FIXED($reading_mm, digits: 0) } mm (at least { $min_points })
carriage-panel = the panel

## computer

computer-load_cores = load { FIXED($load_average, digits: 1) } on { $cores } cores, { $whole }: { $shares }
computer-none_needs_much = no program of the robot needs much
computer-robot_uses_other_programs = the robot uses { FIXED($robot_percent, digits: 0) } %, other programs { FIXED($others_percent, digits: 0) } %

## contact

contact-calibrate_again = { $cause }: calibrate again
contact-not_known_whether_anything_touched = it is unknown whether the stylus touched anything: the cameras did not measure the ball in contact
contact-not_known_whether_anything_touched_2 = it is unknown whether the stylus touched anything: { FIXED($beyond_mm, digits: 1) } mm beyond the surface the ball lagged by { FIXED($lag_mm, digits: 2) } mm
contact-nothing_touched_down_beyond_surface = the stylus touched nothing down to { FIXED($beyond_mm, digits: 1) } mm beyond the surface
contact-nothing_touched_driver_allows_ends = the stylus touched nothing: the driver's limit is { FIXED($beyond_mm, digits: 1) } mm above the surface
contact-nothing_touched_late_images = no touch with late images: { $delays }
contact-panel_higher_measured = the panel is { FIXED($off_mm, digits: 1) } mm higher than measured
contact-panel_lower_measured = the panel is { FIXED($off_mm, digits: 1) } mm lower than measured
contact-stylus_higher_readings_say = the stylus is { FIXED($off_mm, digits: 1) } mm higher than its readings
contact-stylus_lower_readings_say = the stylus is { FIXED($off_mm, digits: 1) } mm lower than its readings
contact-stylus_off_height_readings_say = the stylus is { FIXED($off_mm, digits: 1, sign: 1) } mm off the height of its readings (limit { SHORT($limit_mm) } mm)
stylus-is_up = { $cause }; the stylus is up

## controller

controller-axes_2_2_values_within = axes { $matrix }; expected 2 x 2 values within 0.1 of the identity
controller-busy = busy with { $job }
controller-child_frame_needed = child frame { $child_frame_id }; expected { $base }
controller-clock_jumped_back = the clock jumped back by { FIXED($jumped_back_s, digits: 1) } s
controller-controller_ended = the controller has ended
controller-controller_shutting_down = the controller is shutting down
controller-driver_motion = the driver { $outcome } the motion: { $reason }
controller-error_controller = error in the controller: { $error }
controller-machine_told_stop = { $cause }; the controller has ordered a stop
controller-no_reason_given = no reason given
controller-readings_most_home_believed = readings { $readings_m } m (limit { SHORT($farthest_m) } m from home)
controller-stale_controller_held_up_allowed = stale: the controller was blocked for { FIXED($held_s, digits: 1) } s (limit { SHORT($click_max_age_s) } s)

## drift

drift-none_any_more = every part is at its position again
drift-camera_machine_moved_calibrate_again = a camera or the machine has moved: calibrate again
drift-panel_corner = the panel's corner
drift-panel_moved_camera_look_calibrate = the panel has moved, or a camera; look, and calibrate again if it was a camera
drift-seen_place_calibration = { $control } is { FIXED($control_mm, digits: 1) } mm off its position at the calibration
drift-tip_seen_calibrated_place = the tip is { FIXED($tip_mm, digits: 1) } mm off its calibrated position

## driver

driver-accepted = accepted
driver-stopping = stopping
driver-disabled = disabled
driver-enabled = enabled
driver-accepted_homing = accepted: homing
driver-accepted_reset = accepted: reset
driver-accepted_writing_configured_settings_they = accepted: the driver writes the configured settings and reads them back
driver-driver_ending = the driver is ending
driver-not_opened_yet = not opened yet
driver-refused = refused: { $refusal }
driver-stop_requested = stop requested
driver-thread_guard_ended = the thread of the guard has ended
driver-trajectory_bytes_limit = the trajectory has { $data } bytes (limit { $max_bytes })

## effect

effect-clicks_degrees_more_whole_turn = { SHORT($argument) } clicks of { SHORT($detent_deg) } degrees are more than a whole turn
effect-lamp = lamp { $lamp } -> { $lamp_2 }
effect-no_clicks_detent_deg_layout = { $name } has no clicks (detent_deg in its layout)
effect-no_mark = { $name } has no mark { $mark }; it has { $marks }
effect-none_seen = none seen
effect-nothing_seen_needs_recognition_state = the recognition reports no state of { $name }, which { $kind } needs
effect-screen_changed = screen changed

## face

face-both_cameras_together_see_panel = both cameras together see the panel { FIXED($height_mm, digits: 1) } mm { $side } than its print (limit { SHORT($bound_mm) } mm): measure the panel against its layout's size_mm. If a camera may have turned, calibrate the pair again
face-face_too_little_print_recognised = the face of { $model } has too little print for recognition
face-further_away = further away

## gesture

gesture-angle_degrees_not_zero_most = an angle in degrees, not zero and at most 360 either way
gesture-command_characters_most_allowed = the command has { $text } characters (limit { $max_length })
gesture-drag_needs_found = drag needs { $drag }, found { $text }
gesture-expected_gesture_target_gesture_target = { $body }: expected gesture:target or gesture:target:argument
gesture-expected_id_up_64_letters = { $tail }: expected id= and up to 64 letters, digits, '.', '-' or '_'
gesture-gesture_none = gesture { $kind } is none of { $gestures }
gesture-marked_position_name_degrees_180 = a marked position's name or degrees from -180 to 180
gesture-needs_found = { $kind } needs { $needs }, found { $parts }
gesture-needs_found_nothing = { $kind } needs { $needs }, found nothing
gesture-not_finite = { $what } { $text } is not finite
gesture-not_number = { $what } { $text } is not a number
gesture-point_where_ends = the point x,y@frame where it ends
gesture-seconds_above_0_up_30 = seconds above 0 and up to 30
gesture-takes_no_argument_found = { $kind } takes no argument, found { $parts }
gesture-target_neither_control_name_nor = target { $text } is neither a control's name nor x,y@frame
gesture-whole_number_clicks_not_zero = a whole number of clicks, not zero and at most { $max_clicks } either way

## goal

goal-command = command
goal-goal = goal
goal-cameras_beside = cameras off it
goal-corrected_aim = corrected aim: { $error }
goal-degrees = { $knob } at { FIXED($angle_deg, digits: 1, sign: 1) } degrees
goal-driver_reports_end_motion_beside = the motion ended { FIXED($off_mm, digits: 2) } mm off its target (limit { SHORT($arrival_tolerance_mm) } mm)
goal-frame_none = frame { $frame } is none of { $frames }
goal-goal_waits = the goal waits for it
goal-image_controls_recognition_evaluated = image of the controls that the recognition has evaluated
goal-image_stylus_tracker_evaluated = image that the stylus tracker has evaluated
goal-late_limit = { $what } is late: { FIXED($measured_s, digits: 2) } s (limit { SHORT($limit_s) } s)
goal-looking_effect = looking for the effect
goal-looking_tip = looking at the tip
goal-marker = marker of { $name }
goal-marker_not_seen_within = the cameras did not see the marker of { $knob } within { SHORT($wait_s) } s
goal-move = move to ({ SHORT($x) }, { SHORT($y) }, { SHORT($z) }) m in { $base }
goal-moving_above_target = moving above the target
goal-moving_back_above_target = moving back above the target
goal-moving_out_way = moving out of the way
goal-moving_point = moving to the point
goal-moving_seen_error = moving by the seen error
goal-moving_up = moving up
goal-moving_up_after_fault = moving up after a fault
goal-needs_knob_name_found = { $kind } needs a knob's name, found { $gesture }
goal-next_turn_stylus_up = the next turn: { $error }; the stylus is up
goal-no_more_motion_ordered = { $cause }; no further motion
goal-no_result_motion_driver = no result of the motion from the driver for { FIXED($wait_s, digits: 1) } s
goal-not_picture = { $control } is not in the picture
goal-not_seen_nothing_read_panel = not seen: no reading of the panel for { FIXED($for_s, digits: 1) } s since the touch
goal-nothing_moved = { $error }; nothing moved
goal-nothing_seen_most_allowed_try = the recognition has not seen { $name } { $since } (limit { SHORT($limit_s) } s): try again, or is the computer too busy?
goal-nothing_seen_panel_state_effect = no report of the panel's state, which a { $kind } needs (require_effect)
goal-point_not_finite = point ({ $xyz }) is not finite
goal-press = press ({ SHORT($x) }, { SHORT($y) }) { $unit } in { $frame }
goal-sent_again_try = the controller sends it again, try { $sent } of { $slow_tries }
goal-something_hand_still_hides_after = something (a hand?) still hides { $control } after { SHORT($hidden_wait_s) } s
goal-stale_stamp_old_allowed = stale: the stamp is { FIXED($age_s, digits: 3) } s old (limit { SHORT($goal_max_age_s) } s)
goal-stamp_future_clocks_agree = { $reason }; the stamp is in the future: do the clocks agree?
goal-stands_degrees_off_after_turns = { $knob } is { FIXED($off_deg, digits: 1) } degrees off after { $turns } turns (limit { SHORT($allowed) }); the stylus is up
goal-stylus_gone_down_look_panel = the stylus had already touched: check the panel before you try again; { $reason }
goal-stylus_may_bent_another_one = { $cause }; the stylus may be bent, or another one; nothing moved
goal-then = { $cause }; then { $more }
goal-tip_measured_beside_target_could = the cameras measured the tip off the target, because they could not see it above the target
goal-touched_but_effect_stylus_up = touched, but its effect was { $unread }; the stylus is up
goal-touched_but_no_effect_seen = touched, but the cameras saw no effect within { SHORT($wait_s) } s; the stylus is up
goal-touched_but_not_confirmed_stylus = touched, but not confirmed: { $finding }; the stylus is up
goal-touched_but_not_measured_no = touched, but not measured: no image that the stylus tracker has evaluated { $since }
goal-touching_down = touching down
goal-touching_looking_contact = touching: looking at the contact
goal-touching_turning = touching: turning
goal-waiting_free_view = waiting for a free view
goal-waiting_panel_seen = waiting for the cameras to see the panel
goal-waiting_pictures_contact = waiting for the images of the contact
goal-waiting_up = waiting up to { SHORT($limit_s) } s
goal-z_above_0_where_stylus = z = { SHORT($xyz_m) } m (limit 0, the retracted stylus)
goal-z_must_0_surface_found = z = { SHORT($z) } in { $frame }; expected 0: the panel's pose gives the surface
goal-z_stylus_can_only_up = z = { SHORT($xyz_m) } m: this stylus has only two positions, up (0) and touch
goal-z_touch_panel_lowest_use = z = { FIXED($goal_m, digits: 4) } m would touch the panel there (limit { FIXED($lowest_m, digits: 4) } m); use press to touch

## grbl

grbl-alarm = ALARM:{ $code } ({ $texts })
grbl-allowed_only_while_idle = allowed only while idle
grbl-arc_offsets = arc offsets
grbl-arc_radius = arc radius
grbl-arc_target = arc target
grbl-arc_without_axis_word_plane = arc without an axis word of its plane
grbl-axis_words_without_use = axis words without a use
grbl-bad_jog = bad jog
grbl-bad_number = bad number
grbl-command_not_supported = command not supported
grbl-control_limit_input_active_start = a control or limit input is active at the start
grbl-coordinate_system_beyond_g_59 = coordinate system beyond G59
grbl-eeprom_read_failed = EEPROM read failed
grbl-emergency_stop_pressed = the emergency stop is pressed
grbl-emergency_stop_second_axis = emergency stop or second axis
grbl-error = error:{ $code } ({ $error_texts })
grbl-g_43_1_takes_axis = G43.1 takes the axis of the tool only
grbl-g_53_needs_g_0 = G53 needs G0 or G1
grbl-hard_limit_switch_position_lost = hard limit switch, position lost
grbl-hard_stop = hard stop
grbl-homing_door_opened = homing: door opened
grbl-homing_no_switch_found = homing: no switch found
grbl-homing_not_enabled = homing is off ($22)
grbl-homing_pull_off_did_not = homing: pull-off did not clear the switch
grbl-homing_reset_during_cycle = homing: reset during the cycle
grbl-homing_switch_not_clear = homing: which switch is not clear
grbl-integer_expected = integer expected
grbl-jog_beyond_travel = jog beyond the travel
grbl-laser_mode_needs_pwm = laser mode needs PWM
grbl-letter_expected = letter expected
grbl-limit_switch_engaged = a limit switch is engaged
grbl-limit_switch_engaged_only_homing = a limit switch is engaged; the board allows only homing
grbl-line_length = line { $text } has { $size } bytes with its newline (limits 2 to { $limit })
grbl-line_column_cannot_part_line = line { $text }, column { $column }: { $char } cannot be part of a line
grbl-line_number_out_range = line number out of range
grbl-line_too_long = line too long
grbl-locked_alarm = locked by an alarm
grbl-motor_fault = motor fault
grbl-must_homed_first = home the machine first
grbl-no_axis_words = no axis words
grbl-no_feed_rate = no feed rate
grbl-probe_did_not_make_contact = probe did not make contact
grbl-probe_not_initial_state = probe not in its initial state
grbl-reset_signal_held_fluidnc_no = a reset signal is active, or with FluidNC no axis homes
grbl-reset_while_moving_position_lost = reset while moving, position lost
grbl-safety_door_open = safety door open
grbl-see_manual_firmware = see the manual of the firmware
grbl-soft_limits_need_homing = soft limits need homing
grbl-spindle_fault = spindle fault
grbl-spindle_not_speed = the spindle is not at speed
grbl-statement_not_known = $ statement not known
grbl-step_pulse_shorter_3_us = step pulse shorter than 3 us
grbl-step_rate_above_firmware_maximum = step rate above the firmware's maximum
grbl-target_beyond_soft_limits = target beyond soft limits
grbl-too_long_stored = too long for the board's memory
grbl-tool_number_too_large = tool number too large
grbl-two_commands_one_modal_group = two commands of one modal group
grbl-two_commands_use_axis_words = two commands use the axis words
grbl-unused_value_words = unused value words
grbl-value_must_not_negative = the value must not be negative
grbl-value_word_missing = value word missing
grbl-word_given_twice = word given twice

## guard

guard-points_to = { $points } points to { $place }
guard-another_configuration = another configuration
guard-before_hello = { $name } before hello
guard-closed_after_stop_machine_state = closed { SHORT($within_s) } s after the stop: the machine's state is unknown, the stylus may be down
guard-driver_node_ended = the driver's node has ended
guard-driver_node_sends_too_much = the driver's node sends too much
guard-driver_node_sent_unreadable_message = the driver's node sent an unreadable message: { $error }
guard-driver_node_silent = the driver's node has been silent for { FIXED($silent_s, digits: 2) } s
guard-frame_bytes_limit = the frame has { $data } bytes (limit { $max_frame_bytes })
guard-frame_not_json = the frame is not JSON: { $error }
guard-frame_not_json_object = the frame is not a JSON object
guard-guard = the guard: { $error }
guard-guard_ended = the guard has ended
guard-guard_ending = the guard is ending
guard-guard_hangs_restarted = the guard hangs; the driver restarts it
guard-guard_not_answer = the guard does not answer
guard-link_lost = link lost: { $reason }
guard-points = { $points } points
guard-use_another_program_while_driver = in use by another program, as while a driver runs

## hold

hold-homing = homing
hold-driver_connecting = driver connecting
hold-driver_disconnected = driver disconnected
hold-driver_idle_needed = the driver is { $driver }; expected 'idle'
hold-driver_moving = the driver is moving
hold-no_joint_states = no joint_states
hold-no_joint_states_most_allowed = no joint_states { $since } (limit { SHORT($joints_timeout_s) } s)
hold-no_operator_heartbeat = no operator (heartbeat)
hold-no_operator_heartbeat_most_allowed = no operator heartbeat { $since } (limit { SHORT($heartbeat_timeout_s) } s)
hold-no_picture_left_camera = no image from the left camera
hold-no_picture_left_camera_most = no image from the left camera { $since } (limit { SHORT($camera_timeout_s) } s)
hold-not_calibrated = not calibrated
hold-not_enabled = not enabled
hold-not_homed = not homed
hold-settings_mismatch = settings mismatch
hold-stop_asked = { $text }, a stop is pending
hold-stylus_last_extended_may_still = the last extension of the stylus was { FIXED($last_mm, digits: 1) } mm, and it may still press: homing lifts it

## homing

homing-after_homing_board = after homing the board is { $state_text }
homing-board_must_homed_before_takes = the board accepts no line before homing (${ $number } is { $value }), but the driver must lift the stylus before that: set ${ $number_2 } to 1, as gantry/write_settings does
homing-driver = the driver is { $state_text }
homing-homed_mpos_configuration_says = homed at MPos { $found_mm } mm; expected { $expected_mm } mm (configuration)

## inputs

inputs-calibration_withdrawn = the calibration is no longer valid
inputs-camera_stalled_no_picture = the camera has stalled: no image { $since }
inputs-controller_started_stylus_extended = the controller started with the stylus extended by { FIXED($here_mm, digits: 1) } mm
inputs-driver = the driver is { $driver }
inputs-lost_operator_no_heartbeat = lost the operator: no heartbeat { $age }
inputs-no_joint_states = no joint_states { $since }
inputs-no_pose_panel_recognition_late = no pose of the panel { $since }: the recognition is late
inputs-nothing_heard_driver = no message from the driver
inputs-panel_moved_target_allowed = the panel has moved by { FIXED($moved_mm, digits: 1) } mm at the target (limit { SHORT($panel_moved_mm) } mm)
inputs-panel_not_recognised_most_allowed = no recognition of the panel { $since } (limit { SHORT($panel_max_age_s) } s): is something before it, or too little light?
inputs-pose_panel = pose of the panel
inputs-something_hand_hidden = something (a hand?) has hidden { $control } for { FIXED($hidden_s, digits: 1) } s

## json

json-integer_digits_too_large = an integer of { $text } digits is too large
json-key_stands_twice = a key occurs twice
json-not_json = { $text } is not JSON
json-object_needed_not = expected an object, got { $name }
json-too_large = { $text } is too large

## layout

layout-artwork_needs_one_rectangle_circle = artwork needs one of rectangle_mm, circle_mm, line_from_to_mm, text
layout-circle_radius_above_0_needed = circle_mm = { $circle_mm }; expected a radius above 0
layout-control_reaches_outside_panel = control { $control } at ({ SHORT($x) }, { SHORT($y) }) reaches outside the panel { SHORT($width) } x { SHORT($height_mm) } mm
layout-control_stands_twice = control { $control } occurs twice
layout-depth_not_below_knob_height = depth_mm = { SHORT($depth) } is not below the knob's height_mm = { SHORT($proud_mm) }
layout-detent_deg_not_within_0 = detent_deg = { SHORT($detent) } is not within 0 to 180 degrees
layout-detent_deg_remove_key_knob = detent_deg = { SHORT($detent) }: remove this key for a knob without clicks
layout-dimple_lies_knob_middle_0 = the dimple lies { SHORT($hypot) } to { SHORT($reach_mm) } mm from the knob's middle (limits 0 to { SHORT($knob_mm) } mm)
layout-dimple_mapping_place_diameter_depth = dimple = { $given }; expected a mapping of place_mm, diameter_mm and depth_mm
layout-height_not_within_0_200 = height_mm = { SHORT($proud) } is not within 0 to 200 mm
layout-id_markers_0 = id = { $entry }: { $dictionary } has the markers 0 to { $count }
layout-knob_knob_circle = knob { $name } is a { $shape }; a knob is a circle
layout-mark_letter_z_then_letters = mark { $name }; expected a letter from A to Z, then letters, digits and '_', but not nan or inf, which are numbers
layout-mark_not_within_180_180 = mark { $name } = { SHORT($degrees) } is not within -180 to 180 degrees
layout-marker_stands_twice = marker { $marker } occurs twice
layout-marker_white_rim_under_control = marker { $marker } with its white rim is under control { $control }
layout-marker_white_rim_wide = marker { $marker } at ({ SHORT($x) }, { SHORT($y) }) with its white rim, { FIXED($side_mm, digits: 1) } mm wide,
layout-marks_deg_mapping_names_degrees = marks_deg = { $given }; expected a mapping of names to degrees
layout-n_1_mapping_model_size_controls = { $file_name }:1: expected a mapping with model, size_mm and controls
layout-name_letter_z_then_letters = name { $name }; expected a letter from A to Z, then letters, digits and '_'
layout-no_control = { $model } has no control { $name }; it has { $controls }
layout-no_controls = no controls
layout-only_knob_detent_deg_marks = { $name } is a { $kind }; only a knob has detent_deg, marks_deg or a dimple
layout-reaches_outside_panel = { $text } reaches outside the panel { SHORT($size_mm) } x { SHORT($size_2_mm) } mm
layout-rectangle_width_height_above_0 = rectangle_mm = { $rectangle_mm }; expected width and height above 0
layout-size_circle_wide_high = size_mm = [{ SHORT($width) }, { SHORT($height) }]: a circle is as wide as high
layout-tolerance_not_within_0 = tolerance_mm = { SHORT($value) } is not within 0 to { SHORT($max_tolerance_mm) } mm

## link

link-asking_build = asking for the build
link-board_power_port = { $text }: has the board power, and is { $port } its port?
link-board_reports = the board reports { $state_text }, { $question }?
link-bytes_came_no_grbl_line = { $text }: { $heard_bytes } bytes arrived that are not GRBL's: is { $baud } its line rate (baud), or is another device at { $port }?
link-device_gone = the device has gone
link-error_driver = error in the driver: { $error }
link-firmware_grbl_before_1_1 = the firmware is a GRBL before 1.1, whose reports have another form; expected 1.1
link-firmware_marlin_no_feed_hold = the firmware is Marlin, which has no feed hold; expected GRBL
link-hold_button_pressed = is its hold button pressed
link-no_answer_while = no answer in { SHORT($connect_timeout_s) } s while { $waiting_for }
link-reading_settings = reading the settings
link-reports_feed_min_limit_min = it reports a feed of { FIXED($feed_mm_min, digits: 0) } mm/min (limit { FIXED($feed_limit_mm_min, digits: 0) } mm/min)
link-reports_mpos_off_limit = it reports MPos { $place_mm } mm, { FIXED($off_mm, digits: 2) } mm off (limit { SHORT($tube_mm) } mm)
link-safety_door_open = is its safety door open
link-waiting_banner = waiting for a banner
link-writing_settings = writing the settings

## machine

machine-board_not_answered_within_may = the board has not answered $I within { SHORT($build_within_s) } s and may be homing: the driver resets it
machine-homing_answered_after_board_not = the board answered homing after { FIXED($latency_s, digits: 2) } s, so it has not homed
machine-homing_refused = the board rejected homing: { $text }
machine-homing_took_longer = homing took longer than { SHORT($homing_timeout_s) } s
machine-line = { $error_text } at line { $number } { $line }
machine-no_banner_within_reset = no banner within { SHORT($banner_timeout_s) } s of a reset
machine-no_status_report = no status report for { FIXED($silent_s, digits: 1) } s
machine-refused = the board rejected { $line }: { $text }
machine-stylus_left_extended_allowed = the stylus has been extended for { FIXED($rested_s, digits: 1) } s (limit { SHORT($allowed_s) } s)
machine-stylus_not_lifted = the board did not lift the stylus: { $text }
machine-stylus_not_lifted_time = the board did not lift the stylus in time

## markers

markers-marker_panel_where_print_allowed = by marker { $known } the panel is { FIXED($apart_mm, digits: 1) } mm from where its print is (limit { SHORT($bound_mm) } mm)
markers-marker_where_layout = marker { $dictionary } { $id } is where the layout has { $other }

## motion

motion-lies_outside = { $name } = { FIXED($value_m, digits: 4) } m lies outside { FIXED($low, digits: 4) } to { FIXED($high_m, digits: 4) } m

## operator

operator-gantry_controller_sent_no_sign = gantry_controller has sent no sign of its goal for { FIXED($silent_s, digits: 1) } s

## page

page-drawn_camera_layers_true_false = expected drawn, or camera and layers (true or false)
page-simulated_time_stood_still_bench = simulated time has not advanced for { SHORT($silent_s) } s: the bench, or a program it waits for, is late

## panel

panel-degrees = at { FIXED($angle_deg, digits: 1, sign: 1) } degrees
panel-hidden = hidden by { $hidden_by }
panel-lamp = lamp { $lamp }
panel-line_sight_not_meet_panel = the line of sight does not meet the panel's face from the front
panel-no_pose_panel_most_allowed = no pose of the panel { $since } (limit { SHORT($panel_max_age_s) } s)
panel-none_panel_markers_seen_yet = no camera has seen the panel's markers yet
panel-not_picture = not in the picture
panel-panel_not_recognised = panel not recognised
panel-panel_not_recognised_no_yet = no recognition of the panel: no { $missing } yet
panel-panel_not_seen_where_cameras = the cameras have not seen the panel from their new position (limit { SHORT($look_timeout_s) } s)
panel-panel_plane_being_measured = the measurement of the panel's plane is running
panel-panel_plane_being_measured_driver = the measurement of the panel's plane is running, and the driver does not know the plane yet
panel-panel_pose_old = panel pose is old
panel-panel_recognised_confidence_least_needed = the confidence of the panel's recognition is { FIXED($confidence, digits: 2) } (at least { SHORT($min_confidence) })
panel-stylus = the stylus
panel-unknown_control_nearest = unknown control { $name }; nearest: { $near }

## path

path-joint_names_some_each_once = joint names { $names }; expected some of { $joints }, each once
path-point_between_up_0_down = point { $number }: { $joints } = { SHORT($z_m) } m; a { $kind } has only up, 0, and down, { SHORT($down_m) } m: does the sender treat it as a Z axis (the controller's stylus_two_positions)?
path-point_min_above_min = point { $number }: { $joints } at { FIXED($rate, digits: 0) } mm/min (limit { SHORT($limit) } mm/min)
path-point_not_finite = point { $number }: { $joints } = { $value } is not finite
path-point_outside_0 = point { $number }: { $joints } = { SHORT($value_m) } m is outside 0 to { SHORT($limit_m) } m
path-point_positions_joints = point { $number } has { $positions_m } positions for { $order } joints
path-point_time_start_negative = point { $number }: time_from_start { SHORT($time_s) } s is negative
path-point_time_start_not_follow = point { $number }: time_from_start { SHORT($time_s) } s does not follow { SHORT($clock_s) } s
path-point_velocities_time_not_finite = point { $number }: velocities { $velocities_m_s } or time { $time_s } are not finite
path-trajectory_points_1_needed = the trajectory has { $points } points (limits 1 to { $max_points })

## proof

proof-board_feed_override_rises_although = the board's feed override rises to { SHORT($feed_percent) } % although the driver sets it back
proof-board_left_path = the board left the path: { $deviation }
proof-board_overrides_feed_spindle_set = the board's overrides were { SHORT($feed_percent) } % (feed) and { SHORT($spindle_percent) } % (spindle): the driver set them back to 100 %
proof-board_reports_work_offset_instead = the board reports the work offset { $found_mm } mm instead of { $wanted_mm } mm
proof-board_reset_itself_position_lost = the board has reset itself and lost its position
proof-board_stands_elsewhere_without_command = the board's position has changed without a command from this driver: the true position is unknown
proof-board_stands_instead_off = the board is at { $metres } instead of { $metres_2 }, { FIXED($error_mm, digits: 2) } mm off
proof-cameras_show_stylus_above_panel = the cameras show the stylus { FIXED($height_mm, digits: 1) } mm above the panel: it presses nothing
proof-motion_taken_limit_twice_expected = the motion has taken { FIXED($took_s, digits: 1) } s (limit { FIXED($limit_s, digits: 1) } s, twice the expected time)
proof-shows_no_after = $G shows no { $missing } after { $lines }: { $modes_text }

## recognition

recognition-picture_camera_calibration = the image has { $shape_px } px, the camera's calibration { $size }
recognition-picture_values_uint_8_needed = the image has values of { $dtype }; expected uint8

## record

record-already_recording = already recording to { $output }
record-bag_record_ended = bag_record ended with { $returncode }
record-bag_record_not_installed_beside = this program's folder has no bag_record
record-being_finished_already = bag_record already finishes { $output }
record-cannot_record = cannot record to { $output }: { $error }
record-nothing_being_recorded = no recording is running
record-record_folder_empty_nothing_recorded = record_folder is empty: this bridge records nothing
record-recorded = recorded to { $summary }
record-recording = recording to { $output }

## request

request-one_of = one of { $choices }
request-either_control_point_line = either a control, a point or a line
request-four_corners = four corners
request-integer_0_2_53 = an integer from 0 to 2^53
request-length_most_1000 = a length of at most 1000 mm
request-list = a list
request-n_1_0_1 = -1, 0 or 1
request-n_1_texts = 1 to { $max_steps } texts
request-nanoseconds_text_digits = nanoseconds as a text of digits
request-needed = { $name } = { $value }; expected { $needed }
request-number = a number
request-numbers = { $length } numbers
request-text_up_300_characters_each = a text of up to 300 visible characters
request-text_up_64_characters = a text of up to 64 characters
request-texts_numbers = { $texts } texts and { $length } numbers
request-unknown_field = unknown field { $raw }

## sequence

sequence-nothing = nothing
sequence-unlike = { $check } ({ $instead })
sequence-busy = busy with { $run_id }, { $state }
sequence-check_none = { $place }: check { $text } is none of { $known }
sequence-check_text_list_texts_needed = { $place }: check = { $checks }; expected a text or a list of texts
sequence-controller_neither_taken_nor_refused = the controller has neither accepted nor rejected it within { SHORT($accept_s) } s
sequence-controller_rest_without_answer = the controller has been at rest for { SHORT($accept_s) } s without an answer to it
sequence-effect_screen_lamp_name_colour = effect, screen, lamp:NAME=COLOUR (or off), angle:NAME=DEGREES (or MARK)
sequence-file_name_characters_all_seen = file's name { $shown } of { $name } characters (limit { $limit }, all visible)
sequence-gesture_check_within_known = { $place }: { $found }; known keys: do (a gesture), check and within_s
sequence-ids_given_sequencer = { $place }: { $gesture }: the sequencer gives the ids
sequence-lamp_none = { $place }: lamp { $found } is none of { $lamps }
sequence-machine_told_stop = { $given_up }; the sequencer has ordered a stop, and the driver is { $driver }
sequence-machine_told_stop_but_says = { $given_up }; the sequencer has ordered a stop, but the driver reports { $driver }: look at the machine
sequence-n_1_mapping_steps_needed = { $file_name }:1: expected a mapping with steps
sequence-name_characters_expected_up_printable = { $place }: a name of { $name } characters; expected up to { $max_name } printable ones
sequence-name_text_steps_list_known = { $place }: { $key }; known keys: name (a text) and steps (a list)
sequence-neither_text_nor_mapping = { $place }: { $entry } is neither a text nor a mapping
sequence-no_change = no change
sequence-no_gantry_controller_listens = no gantry controller is running
sequence-no_gesture = no gesture
sequence-no_lamp_seen_lamps_seen = the cameras see no lamp on { $control }, only on { $lit }
sequence-no_mark = no mark { $check }
sequence-no_sign_work = no sign of progress for { SHORT($answer_timeout_s) } s
sequence-not_looked = not looked for
sequence-not_seen_time = not seen in time: { $missing }
sequence-not_seen_yet = not seen yet
sequence-only_knob_angle = { $control } is a { $kind }; only a knob has an angle
sequence-panel_no_nearest = this panel has no { $name }; nearest: { $near }
sequence-panel_no_screen = this panel has no screen
sequence-sequencer_ending = the sequencer is ending
sequence-sequencer_held_up = the sequencer was blocked for { FIXED($held_up_s, digits: 1) } s
sequence-step_running = step { $number }/{ $steps }: { $gesture }
sequence-step_failed = step { $number } of { $steps }, { $gesture }: { $cause }
sequence-place = step { $number }
sequence-step_unfit = step { $number }: { $what }
sequence-steps = { $steps } steps
sequence-steps_1_needed = { $entries } steps (limits 1 to { $max_steps })
sequence-unknown_key = unknown key { $map }
sequence-within_seconds_above_0_up = { $place }: within_s = { $within }; expected seconds above 0 and up to 60

## servo

servo-seen_error_after_corrections_allowed = the seen error is { FIXED($sideways_mm, digits: 2) } mm after { $corrections } corrections (limit { SHORT($max_error_mm) } mm)
servo-seen_errors_add_up_correction = the seen errors add up to a correction by { FIXED($total_mm, digits: 2) } mm (limit { SHORT($most_mm) } mm)
servo-tip_seen_above_surface_when = the tip was { FIXED($above_mm, digits: 1) } mm above the surface when it should touch (limit { SHORT($max_depth_error_mm) } mm): does the stylus come down, is the image new?
servo-tip_seen_beside_above_place = the tip is { FIXED($sideways_mm, digits: 2) } mm to the side of and { FIXED($error_mm, digits: 2, sign: 1) } mm above its target (limits { SHORT($max_correction_m) } and { SHORT($max_depth_error_mm) } mm): calibrate again
servo-tip_seen_times_times_within = the cameras saw the tip { $tips } times (at least { $needed } times within { SHORT($spread_mm) } mm)
servo-touched_beside_target_allowed = touched { FIXED($error_mm, digits: 2) } mm off the target (limit { SHORT($bound_mm) } mm)
servo-touched_but_not_measured = touched, but not measured: { $unseen_text }

## settings

settings-not_kept = the board did not keep a setting: { $setting }
settings-became_write_back = ${ $n } became { $settings }, it was { $kept }: write it back
settings-bit_0_bit_5 = bit 0 ({ $machine_position }) or bit 5 ({ $work_offset })
settings-board_no_settings = the board has no settings
settings-board_told_no_settings = the board sent no settings
settings-cannot_written = cannot write { $value }
settings-configuration = the configuration
settings-could_not_read_noise_line = the driver could not read { $missing }: is there noise on the line? The lines that the board runs after each reset are unknown: connect it again
settings-line_given_twice = line { $place }: ${ $number } occurs twice
settings-line_not_value = line { $place }: { $text } is not $number=value
settings-line_not_within = line { $place }: { $text } is not within -{ SHORT($largest) } to { SHORT($largest_2) }
settings-missing_says = ${ $number } is missing; expected { SHORT($value) } ({ $who })
settings-motors_let_go_can_pushed = ${ $idle_delay } is { $idle }: motors without power can move unnoticed, { $stays_on } keeps them on
settings-nothing_accept_driver = nothing to accept: the driver is { $state_text }
settings-nothing_write = nothing to write: { $known }
settings-profile_no_setting = the profile has no setting
settings-reports_tell_no_machine_position = ${ $number } is { $shown }: its reports have no machine position without { $lacks }; expected { SHORT($value) } ({ $who })
settings-runs_after_each_reset_must = { $name } runs { $text } after each reset; expected empty: unlock by $X, then send { $name_2 }=
settings-runs_after_reset_must_empty = { $name } runs { $text } after a reset; expected empty: remove it from the board's config file
settings-says = ${ $number } is { $text }; expected { SHORT($value) } ({ $who })
settings-settings_written_board_rest_stylus = the driver writes settings only to a board at rest with the stylus up; it is { $state_text }
settings-these_settings = it has these settings
settings-writing = writing { $lines }
settings-written = value written

## sources

sources-no_known_program = no known program
sources-no_program = no program
sources-program_without_name = a program without a name
sources-programs_publish = { $count } programs publish { $topic }: { $listed }
sources-times = { $name } ({ $count } times)
sources-trajectory_programs_allows = from { $found }: trajectory_programs allows { $allowed }

## state

state-because = { $state }: { $reason }
state-named = { $state }

## stereo

stereo-left_right_images_differ_tolerance = left and right images differ by { FIXED($apart_ms, digits: 1) } ms, tolerance { SHORT($tolerance_ms) } ms: set pair_tolerance_s, as a panel at rest looks the same in both

## still

still-machine_not_stood_still = the machine has not been at rest for { SHORT($settle_s) } s
still-no_joint_states_arrive = no joint_states arrive
still-tip_scatters_accepted = the tip scatters by { FIXED($scatter_mm, digits: 2) } mm (limit { FIXED($scatter_2_mm, digits: 2) } mm)

## stop

stop-after = { $text }, after: { $reason }
stop-after_reset_board_reports_mpos = after the reset the board reports MPos { $found_mm } mm instead of { $stood_mm } mm: it has lost its position
stop-board_locked_alarm_whose_number = the board is locked by an alarm whose number did not arrive
stop-board_without_command_here = the board is in { $state_text } without a command from here
stop-nothing_reset_driver = nothing to reset: the driver is { $state_text }
stop-reset_left_board_locked_position = the reset left the board locked: it has lost its position
stop-stop_not_complete_yet = the stop is not complete yet
stop-stylus_left_down_while_no = the stylus stayed down while no driver was connected
stop-stylus_not_lifted_still_extended = the board did not lift the stylus: it is still extended by { FIXED($extension_mm, digits: 1) } mm

## stream

stream-board_not_told_work_offset = the board has not sent its work offset (WCO) yet
stream-board_not_told_work_offset_2 = the board has not sent the same work offset (WCO) twice yet
stream-board_went = the board went to { $state_text }
stream-driver_inactive = the driver is inactive
stream-no_operator_heartbeat_yet = no operator's heartbeat yet
stream-nothing_pause_driver = nothing to pause: the driver is { $state_text }
stream-nothing_resume_driver = nothing to resume: the driver is { $state_text }
stream-operator_heartbeat_lost_old_allowed = operator's heartbeat lost: { FIXED($age_s, digits: 2) } s old (limit { SHORT($heartbeat_timeout_s) } s)
stream-place_work_offset_changed_since = position or work offset have changed since the check of the program
stream-program_lines_about = program of { $checked } lines, about { FIXED($seconds_s, digits: 1) } s
stream-stale_stamp_old_allowed = stale: its stamp is { FIXED($age_s, digits: 3) } s old (limit { SHORT($limit_s) } s)
stream-trajectory_driver = trajectory at the driver

## stylus

stylus-extended = the stylus is extended by { FIXED($extended_mm, digits: 1) } mm
stylus-down = the stylus is down
stylus-servo_may_without_pulses_sink = the servo may be without pulses and sink, the stylus may press
stylus-solenoid_without_power_stylus_up = the solenoid is without power, the stylus is up
stylus-stylus_not_lifted_may_still = the board did not lift the stylus, it may still press

## target

target-bare_face = the bare face
target-connectors_never_pressed = { $control } is a { $kind }; the stylus never presses connectors
target-dimple_wide_stylus_needs_more = the dimple of { $control } is { SHORT($diameter_mm) } mm wide, the stylus needs more than { FIXED($wide_mm, digits: 1) } mm to reach its bottom
target-drag_begins_ends_must_stay = the drag begins on { $control } and ends on { $name }; it must stay on one
target-drag_begins_only_touch_area = a drag begins on { $name }; expected a touch_area
target-only_knob_can_turned = { $control } is a { $kind }; only a knob can turn
target-only_knob_can_turned_no = only a knob can turn, and there is no control at this point
target-panel_leans_degrees_most_allowed = the panel leans by { FIXED($tilt_deg, digits: 1) } degrees (limit { SHORT($max_tilt_deg) })
target-pixel_lies_outside_picture = pixel ({ SHORT($x) }, { SHORT($y) }) lies outside the picture of { $width } x { $height }
target-point_beside_high_needed = the point is { FIXED($gap_mm, digits: 1) } mm off { $other } ({ FIXED($height_mm, digits: 0) } mm high), at least { FIXED($needed_mm, digits: 1) } mm
target-point_lies_outside_panel = the point ({ FIXED($point, digits: 4) }, { FIXED($point_2, digits: 4) }) m in { $panel } lies outside the panel, ({ FIXED($low, digits: 3) }, { FIXED($low_2, digits: 3) }) to ({ FIXED($high, digits: 3) }, { FIXED($high_2, digits: 3) }) m
target-stylus_degrees_play_dimple_most = the stylus has { FIXED($play_deg, digits: 1) } degrees of play in the dimple of { $control } (limit { SHORT($most_bias_deg) })
target-touch_needs_extension_stylus_reaches = the touch needs an extension of { FIXED($touch_z_m, digits: 4) } m, the stylus reaches { FIXED($down_m, digits: 4) } m
target-turned_dimple_found_marker_turn = the stylus turns { $control } in its dimple, and finds the dimple by its marker: turn it by its name

## teach

teach-not_understood = cannot read the request: { $kind }: { $error }
teach-already_remove_choose_another_model = { $path } is there already; remove it, or choose another model
teach-another_panel_taught_before_picture = a request for another panel came before the image of { $stamp_ns }
teach-cannot_encoded = cannot encode { $template }
teach-control_kind_none = control { $control }: kind { $kind } is none of { $control_kinds }
teach-control_name_kind_widthxheight_height = control { $text }; expected NAME:kind:u,v:WIDTHxHEIGHT[:height]
teach-corners_not_go_round_face = corners { $corners } do not go round the face: lower left, lower right, upper right, upper left
teach-error_while_teaching = error while teaching: { $error }
teach-four_corners_needed = { $corners }; expected four corners u,v
teach-model_letter_then_up_40 = model { $model }; expected a letter, then up to 40 letters, digits and '_'
teach-picture_did_not_come_within = the image of { $stamp_ns } did not arrive within { SHORT($picture_wait_s) } s
teach-pixel_beyond_camera_calibration_reaches = pixel { FIXED($u, digits: 0) }, { FIXED($v, digits: 0) } is beyond what the camera's calibration reaches
teach-request_not_understood_more_characters = cannot read the request: more than { $max_request } characters or { $max_depth } brackets
teach-sides_48_8192_needed = { FIXED($wide, digits: 0) } x { FIXED($high_px, digits: 0) } px at { SHORT($px_per_mm) } px/mm (limits 48 to 8192 px)
teach-teach_folder_not_set_nowhere = teach_folder is empty: there is no folder for the layout
teach-wrote = wrote { $layout } and { $template }

## template

template-sides_16_8192_needed = { $width } x { $height_px } px at { SHORT($px_per_mm) } px/mm (limits 16 to 8192 px)
template-template_picture_layout = the template picture has { $found } x { $found_px } px, the layout's { SHORT($size_mm) } x { SHORT($size_2_mm) } mm at { SHORT($picture_px_per_mm) } px/mm are { FIXED($wanted, digits: 0) } x { FIXED($wanted_px, digits: 0) } px

## text

text-more = { $first }: { $second }
text-and_also = { $first }; { $second }
text-both = { $first } and { $second }
text-listed = { $first }, { $second }
text-quoted = '{ $text }'

## tips

tips-left_right_images_differ_tolerance = left and right images differ by { FIXED($difference_ms, digits: 1) } ms, tolerance { SHORT($tolerance_ms) } ms: set { $parameter }
tips-right_image_before_not_show = the right image before it does not show the ball
tips-rows_differ_above_left_image = rows differ by { FIXED($rows_px, digits: 2) } px, above { SHORT($row_limit_px) }, at the left image's instant

## tour

tour-above = x from above
tour-above_2 = y from above
tour-below = x from below
tour-below_2 = y from below

## views

views-board_not_seen_both_cameras = one camera does not see the board
views-board_not_seen_whole = not all of the board is in view
views-both_cameras_pictures_apart_most = the images of both cameras are { FIXED($best_ms, digits: 1) } ms apart (limit { SHORT($most) })
views-hold_board_differently = hold the board differently
views-hold_board_still = hold the board still
views-no_pictures_yet = no images yet
views-picture_refused = picture refused: { $error }
views-show_board = show the board
views-show_board_farther_away = show the board from farther away
views-show_board_nearer_filling_half = show the board from nearer, filling half of the picture
views-show_board_nearer_picture_edge = show the board nearer to the picture's { $needed } edge
views-tilt_board_20_45_degrees = tilt the board by 20 to 45 degrees in different directions ({ $tilted } of 4 views)
views-views = { $kept }/{ $wanted } views

## wait

wait-for_s = for { FIXED($age_s, digits: 1) } s
wait-image_left_camera = image of the left camera

## yaml

yaml-characters = { $key } = { $value }..., { $value_2 } characters
yaml-colour_such_ff_8800_needed = { $key } = { $value }; expected a colour such as "#ff8800"
yaml-expected_key_value = { $pair }: expected KEY=VALUE
yaml-expected_up_printable_characters = { $found }: expected up to { $max_text } printable characters
yaml-key_stands_twice = key { $key } occurs twice
yaml-more_levels = more than { $max_depth } levels
yaml-more_open_brackets = more than { $max_depth } open brackets
yaml-more_values = more than { $max_nodes } values
yaml-must_list_mappings = { $key } must be a list of mappings
yaml-none = { $key } = { $value } is none of { $choices }
yaml-numbers_needed = { $key } = { $value }; expected { $count } numbers
yaml-numbers_up_10000_needed = { $key } = { $value }; expected { $value_2 }numbers up to 10000
yaml-text_bytes_limit = the text has { $size } bytes (limit { $max_bytes })
yaml-text_needed_quote = { $key } = { $value }; expected a text (quote it)
yaml-unknown_key_known = unknown key { $map }; known: { $names }
yaml-value_cannot_read = { $pair }: cannot read the value

## envelope

envelope-sideways = the path moves { FIXED($measured_mm, digits: 1) } mm sideways with the stylus extended (limit { FIXED($limit_mm, digits: 1) } mm)
envelope-too_low = the path moves sideways { FIXED($measured_mm, digits: 1) } mm above the panel (limit { FIXED($limit_mm, digits: 1) } mm)
envelope-too_deep = the path goes { FIXED($measured_mm, digits: 1) } mm beyond the panel (limit { FIXED($limit_mm, digits: 1) } mm)
envelope-old_panel = the panel's plane is { FIXED($age_s, digits: 1) } s old (limit { FIXED($limit_s, digits: 1) } s)
envelope-no_panel = the panel's plane is unknown: the stylus would extend { FIXED($measured_mm, digits: 1) } mm (limit { FIXED($limit_mm, digits: 1) } mm)
