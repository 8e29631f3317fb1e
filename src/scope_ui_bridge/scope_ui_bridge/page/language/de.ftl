# Sätze der Bedienseite und der Programme des Graphen auf Deutsch; die Schlüssel sind die von en.ftl und von
# icu_common, messages/en.ftl. Das Format ist Fluent: https://projectfluent.org/fluent/guide.

product = Ferninstrument
skip_controls = Zum Pult springen
stop = STOP
stop_key = Esc
view_title = Livebild
chip_driver = Maschine
chip_controller = Steuerung
chip_calibration = Kalibrierung
chip_recognition = Front
chip_video = Bild
chip_video_light = Bild, verkleinert
chip_link = Leitung
camera_choice = Kamera
camera_left = Links
camera_right = Rechts
layers = Ebenen
layer_controls = Tasten
layer_panel = Umriss
layer_corners = Ecken
layer_edges = Kanten
layer_stylus = Stift
layer_path = Weg
choose_control = Bedienelement wählen
choose_placeholder = Element wählen …
choose_nothing = Keine Front in Sicht
missing_picture = Von der Kamera kam noch kein Bild: Ist sie angeschlossen, läuft ihr Programm?
missing_panel = Keine Front erkannt: Die linke Kamera muss sie ganz sehen, gut beleuchtet und unverdeckt.
missing_camera = Eine Kamera ist nicht kalibriert, daher hat kein Element einen Platz im Bild: zuerst kalibrieren.
controls_group = Bedienelemente im Bild
position = Position
axis_x = X
axis_y = Y
axis_stylus = Stift ab
desk = Pult
mm = { $value } mm
mm_bound = { $value } mm (95 %: bis { $bound })
ms = { $value } ms

lease_title = Bedienung
lease_free = Niemand bedient. Sie sehen zu.
lease_mine = Sie bedienen.
lease_other = { $name } bedient. Sie sehen zu.
lease_declined = { $name } behält die Bedienung.
lease_asked = { $name } bittet um die Bedienung.
lease_overtaken = { $name } hat nach Ihnen um die Bedienung gebeten; Ihre Bitte gilt nicht mehr.
lease_waiting = Sie haben { $name } um die Bedienung gebeten.
other_page = { $name } (andere Seite)
lease_take = Bedienung übernehmen
lease_request = Um Bedienung bitten
lease_withdraw = Widerrufen
lease_release = Abgeben
lease_grant = Übergeben
lease_decline = Ablehnen
you = { $name } · { $count } dabei

selection_title = Ausgewählt
selection_none = Nichts ausgewählt
selection_hint = Ein Element oder eine Stelle der Front anklicken, dann hier bestätigen.
selection_point = Stelle auf der Front
selection_detail = { $kind } · { $x }; { $y } mm auf der Front
kind_button = Taste
kind_knob = Drehknopf
kind_touch_area = Berührbildschirm
kind_connector = Buchse
kind_point = Stelle
act_press = Drücken
act_hold = Halten
act_turn_minus = ↺ Drehen
act_turn_plus = Drehen ↻
hold_seconds = Wie lange halten
turn_degrees = Wie weit drehen
clear = Aufheben

call_enable = Freigeben
call_disable = Sperren
call_home = Referenzfahrt
call_calibrate = Kalibrieren
call_reset = Nach Stop zurücksetzen
confirm_home = Bestätigen: Fahrt
confirm_calibrate = Bestätigen: kalibrieren

log_title = Befehle
log_time = Zeit
log_what = Befehl
log_result = Ergebnis
log_error = Fehler
log_who = Von
log_empty = Noch kein Befehl.
footer = STOP ist kein Not-Halt: dafür den verdrahteten benutzen.
sign_out = Abmelden

action_press = Drücken
action_hold = Halten
action_turn = Drehen
action_stop = STOP
action_home = Referenzfahrt
action_reset = Zurücksetzen
action_enable = Freigeben
action_disable = Sperren
action_calibrate = Kalibrieren
status_sent = gesendet
under_way_record = startet, noch keine Aufzeichnung
under_way_end_record = schreibt, was noch zu schreiben ist
status_accepted = in Arbeit
status_reached = erledigt
status_done = erledigt
status_aborted = abgebrochen
status_rejected = abgelehnt
status_failed = nicht gesendet
status_no_answer = keine Antwort
said = { $action } { $target }: { $status }. { $reason }
said_error = { $action } { $target }: { $status }, gemessener Fehler { $error } mm. { $reason }
effect = Wirkung: { $effect }.
touch_pressed = Gedrückt: Kontakt und Wirkung.
touch_touched = Berührt: Kontakt, keine Wirkung zu sehen.
touch_not_touched = Nicht berührt.
touch_unknown = Ob der Stift die Front berührt hat, ist nicht bekannt.

unknown = unbekannt
state_disconnected = Getrennt
state_connecting = Verbindet
state_unhomed = Ohne Referenz
state_homing = Referenzfahrt
state_disabled = Gesperrt
state_idle = Ruht
state_moving = Bewegt sich
state_stopped = Gestoppt
state_alarm = Alarm
state_mismatch = Falsch eingestellt
state_waiting = Wartet
state_ready = Bereit
state_looking = Schaut
state_touching = Berührt
state_uncalibrated = Keine
state_calibrating = { $reason }
state_calibrated = Kalibriert
state_drifted = Verschoben
state_failed = Misslungen
recognised = { $percent } %
not_recognised = Unerkannt
live = { $age } ms
no_picture = Kein Bild
stale = VERALTET · { $age } s alt
link_ok = { $rtt } ms
link_lost = WEG

banner_connecting = Verbindet …
banner_ready = Bereit. Ein Element im Bild wählen, dann bestätigen.
banner_viewing = Sie sehen zu. Zum Bedienen die Bedienung übernehmen.
banner_viewing_other = Sie sehen zu. Zum Bedienen die Bedienung erbitten.
banner_calibrating = Kalibriert, { $progress }: die Maschine bewegt sich von selbst. STOP oder Esc hält an.
banner_moving = Bewegt sich. STOP oder Esc hält an.
banner_moving_stale = Bewegt sich, und das Livebild ist alt. STOP oder Esc hält an.
banner_waiting = Nicht bereit: { $reason }
banner_link_viewer = Die Verbindung ist verloren. STOP von dieser Seite kommt vielleicht nicht an. Neuer Versuch …
banner_stop_failed = STOP ist nicht durchgekommen. Den verdrahteten Not-Halt benutzen.
banner_link = Die Verbindung ist verloren. Die Maschine hält von selbst an. Neuer Versuch …
banner_stale = Das Livebild ist alt. Sie können nichts wählen oder bewegen.
banner_stopped = GESTOPPT – { $reason }.
banner_stopped_bare = GESTOPPT.
banner_until_reset = Nichts bewegt sich vor „Nach Stop zurücksetzen“.
banner_alarm = ALARM – { $reason }
banner_lost_control = Sie bedienen nicht mehr: Sie haben die Bedienung abgegeben, oder diese Seite war zu lange verdeckt oder still.

stopped_page_frozen = die Seite des Bedieners antwortete nicht mehr (eingefroren oder überlastet)
stopped_link_lost = die Verbindung zur Seite des Bedieners ist abgerissen
stopped_page_blind = die Seite des Bedieners bekam kein neues Bild (Leitung langsam oder weg, Kamera steht)
stopped_page_hidden = die Seite des Bedieners war verdeckt (anderer Tab, anderes Fenster oder gesperrter Bildschirm)
stopped_bridge_held_up = die Brücke der Seite stand und sendete keinen Herzschlag (Rechner überlastet?)
stopped_by_person = { $who } hat STOP gedrückt
stopped_by_controller = die Steuerung des Roboters hat angehalten: { $who }
stopped_elsewhere = der Stop kam von außerhalb dieser Seite
stopped_heartbeat = der Herzschlag des Bedieners blieb aus: Seite, Brücke oder Verbindung antwortete nicht
stopped_after = – { $seconds } s lang nichts
stopped_page_gone = der Bediener hat die Seite geschlossen oder neu geladen
stopped_flooding = die Seite des Bedieners hat viel zu viele Nachrichten gesendet; die Brücke hat ihre Verbindung getrennt
stopped_signed_out = die Anmeldung des Bedieners ist beendet
stopped_released = der Bediener hat die Bedienung während einer Bewegung abgegeben

oversized = Die Nachricht hat { $size } Byte (Grenze { $limit }).
malformed = Die Brücke kann die Nachricht nicht lesen: { $what }
rate_limited = Zu viele Nachrichten; höchstens { $limit } in der Sekunde.
old_boot = Die Brücke ist neu gestartet; die Seite neu laden.
replayed = Die Brücke hat diese Nachricht schon bekommen.
too_many_viewers = { $limit ->
    [one] Der einzige Platz ist besetzt.
   *[other] Alle { $limit } Plätze sind besetzt.
}
lease_held = Jemand anders bedient.
no_lease = Zuerst die Bedienung übernehmen.
no_request = Niemand bittet um die Bedienung.
other_request = Inzwischen bittet jemand anders um die Bedienung; noch einmal hinsehen.
stale_epoch = Die Bedienung hat inzwischen gewechselt; noch einmal hinsehen.
reset_first = Zuerst „Nach Stop zurücksetzen“ drücken.
ask_first = Zuerst um die Bedienung bitten.
wait_for_control = Sie haben um die Bedienung gebeten: warten Sie, bis der Bediener sie übergibt.
busy_moving = Nicht, während sich etwas bewegt.
busy_pending = Der letzte Befehl ist noch nicht zu Ende.
frame_unknown = Die Brücke kennt das angeklickte Bild nicht.
frame_old = Das Bild war { $age_ms } ms alt (Grenze { $limit_ms } ms). Hinsehen und noch einmal klicken.
panel_not_seen = Die Front ist nicht erkannt.
recognition_silent = Die Erkennung schweigt seit { $age_s } s (Grenze { $limit_s } s).
low_confidence = Die Sicherheit der Erkennung der Front ist { $confidence } (mindestens { $limit }).
no_controller = Die Steuerung läuft nicht.
not_ready = Die Steuerung ist nicht bereit: { $state } { $reason }
unknown_control = Es gibt kein Element { $control }.
not_operable = { $control } ist eine Buchse; der Stift berührt keine Buchsen.
point_needs_left = Stellen bitte im linken Bild wählen.
frame_ahead = Das Bild ist der Uhr der Brücke um { $ahead_ms } ms voraus (Grenze { $limit_ms } ms). Die Uhren beider Rechner stellen.
off_picture = Die Stelle ({ $u }; { $v }) liegt außerhalb des Bildes von { $width } x { $height } Pixeln.
press_late = Sie haben das vor { $late_ms } ms gedrückt, als die Seite beschäftigt war (Grenze { $limit_ms } ms). Hinsehen und noch einmal drücken.
no_number = Zuerst eine Zahl eingeben.
number_wanted = Bitte eine Zahl von { $min } bis { $max }.
off_panel = Diese Stelle ({ $x_mm }; { $y_mm } mm) liegt neben der Front.
came_late = Das brauchte { $late_ms } ms bis zur Brücke (Grenze { $limit_ms } ms). Die Brücke führt es nicht aus.
before_stop = Sie haben danach STOP gedrückt; die Brücke führt es nicht aus.
selection_gone = Noch einmal wählen.
wrong_gesture = Das geht mit diesem Element nicht.
panel_moved = Die Front hat sich seit der Wahl um { $moved_mm } mm bewegt (höchstens { $limit_mm } mm). Noch einmal wählen.
picture_late = Das Bild ist { $age_ms } ms alt (Grenze { $limit_ms } ms).
link_down = Es gibt keine Verbindung zur Brücke.

notice = Hinweis
language_name = Deutsch
help = Hilfe
help_title = Tasten
help_close = Schließen
help_stop = STOP, von jeder Seite, auch ohne die Bedienung
help_tab = Durch alles gehen; Pfeiltasten gehen im Bild von Element zu Element
help_enter = Wählen und bestätigen
help_turn = Den gewählten Knopf drehen
help_jog = Fahren, solange gehalten, Stift oben
help_zoom = Bild vergrößern; 0 zeigt alles
help_control = Bedienung übernehmen
help_help = Diese Liste
help_single = Tasten ohne Strg oder Alt wirken (Esc stoppt immer)
role_viewer = Sie dürfen zusehen und stoppen, nicht bedienen.
role_name_viewer = Zuschauer
role_name_operator = Bediener
role_name_engineer = Techniker
role_needed = Dafür ist die Rolle { $role } nötig.

tools = Bild
zoom_in = Vergrößern
zoom_out = Verkleinern
zoom_fit = Ganzes Bild zeigen
freeze = Festhalten
compare = Vergleichen
compare_hint = Das Bild vor dem letzten Befehl mit dem Livebild vergleichen
snapshot = Speichern
wipe = Anteil des Bildes vor der Geste
before_time = davor · { $time }
frozen_no_action = Ein festgehaltenes Bild liegt über dem Livebild. Noch einmal Festhalten oder Vergleichen drücken.

tabs = Maschine, Fahren, Verläufe
tab_machine = Maschine
tab_move = Fahren
tab_plots = Verläufe
tab_console = Konsole
move_hint = Die Pfeile fahren, solange gehalten, mit dem Stift oben.
move_needs_idle = Die Maschine muss ihre Referenz haben, freigegeben sein und ruhen.
jog = Fahren, solange gehalten
jog_left = Nach links
jog_right = Nach rechts
jog_up = Nach oben
jog_down = Nach unten
jog_step_label = Weite
go_to = Zu einer Stelle fahren (mm)
go = Fahren
call_accept_settings = Einstellungen der Platine annehmen
confirm_accept_settings = Bestätigen: annehmen
action_move = Fahren nach
action_jog = Fahren
action_accept_settings = Einstellungen annehmen
plot_position = Position, letzte Minute
plot_latency = Verzögerung, letzte Minute
plot_error = Gemessener Fehler, letzte Berührungen
plot_empty = noch nichts
console_hint = Meldungen der Programme der Maschine. Von hier können Sie nichts senden.
console_empty = Noch nichts.
replay = Dies ist eine Aufzeichnung: nur zum Ansehen.
banner_replay = AUFZEICHNUNG einer Sitzung. Von hier können Sie nichts bewegen.
tab_calibrate = Kalibrieren
guide = Kalibrierung, Schritt für Schritt
guide_machine = Die Maschine hat ihre Referenz und ist freigegeben
guide_tip = Beide Kameras sehen die Spitze des Stifts
guide_run = Die Kameras messen die Spitze an mehreren Stellen: { $done } von { $all }
guide_run_idle = Die Kameras messen die Spitze an mehreren Stellen
guide_result = Das Ergebnis ist gut genug
guide_coverage = Stellen, an denen die Kameras die Spitze gemessen haben
guide_numbers = gemessen { $rms } mm rms, geprüft { $held } mm, vorhergesagt { $predicted } mm
guide_boards = { $boards } · x { $x } · y { $y } · Größe { $size } · Neigung { $skew }
guide_by_hand = Von Hand
yes = erledigt
no = noch nicht
call_add_sample = Aufnehmen
call_solve = Rechnen
call_save = Sichern
call_record = Aufzeichnen
call_end_record = Aufzeichnung beenden
action_add_sample = Stelle aufnehmen
action_solve = Rechnen
action_save = Kalibrierung sichern
action_record = Aufzeichnen
action_end_record = Aufzeichnung beenden
chip_recording = Aufzeichnung
chip_simulation = Simulierte Zeit
simulation_slow = { $factor } der Echtzeit: Der Computer ist ausgelastet
recording_by = Aufzeichnung seit { $time }, begonnen von { $who }.
recording_program = Aufzeichnung seit { $time }, durch das Programm { $who }.
recording_at_least = Aufzeichnung seit mindestens { $time }, durch das Programm { $who }.
recording_on = Die Aufzeichnung der Sitzung läuft.
recording_one_less = Eine Aufzeichnung ist zu Ende; eine andere läuft weiter.
recording_off = Die Aufzeichnung ist zu Ende.
driver_facts = Was der Treiber zählt
log_search = Suchen
log_export = Ausgeben
log_found = { $count } von { $all }

stopped_no_picture = während einer Bewegung kam kein Kamerabild (Kamera steht oder Rechner überlastet)
wrong_password = Name oder Passwort ist falsch.
wrong_token = Dieses Kennwort gilt nicht. Vielleicht ist es schon benutzt.
wait = Zu viele Fehlversuche. Einige Sekunden warten und noch einmal versuchen.
sign_in = Anmelden
stay_mine = Ihre Anmeldung endet binnen { $minutes } min. Dann hält die Maschine, der Stift hebt sich, und Sie bedienen nicht mehr. Hier neu anmelden unterbricht nichts.
stay_watching = Ihre Anmeldung endet binnen { $minutes } min. Melden Sie sich hier neu an, um weiterzumachen.
stay = Neu anmelden
stay_done = Sie bleiben angemeldet.
signed_out = Ihre Anmeldung ist zu Ende.
sign_in_ended = Ihre Anmeldung ist beendet: ihre Zeit war um, Ihr Zugang hat sich geändert, oder die Brücke ist neu gestartet. Bitte neu anmelden.
sign_in_title = Anmelden – Ferninstrument
sign_in_token = Mit dem Einmalkennwort anmelden, von der Person, die den Roboter gestartet hat. Die Brücke gibt es beim Start aus.
sign_in_name = Name
sign_in_password = Passwort
sign_in_token_label = Einmalkennwort
sign_in_no_token = Kein Kennwort, oder schon benutzt? Wer den Roboter betreut, hat ein neues. (Auf SIGUSR1 gibt die Brücke es aus.)
not_at_rest = Die Maschine ruht nicht: { $state } { $reason }
position_unknown = Es ist nicht bekannt, wo der Stift ist.
jog_step = Ein Schritt von { $step_mm } mm ist zu weit; höchstens { $limit_mm } mm.
jog_refused = Kein Schritt: { $what }. Für einen neuen Versuch den Pfeil noch einmal drücken.

kind_line = Linie
selection_a_line = Linie auf dem Berührbildschirm
selection_line = von ({ $x }; { $y }) nach ({ $to_x }; { $to_y }) mm
act_double = Doppelt drücken
act_long = Lange drücken
act_drag = Diese Linie ziehen
act_click_minus = ↺ Raste
act_click_plus = Raste ↻
click_count = Wie viele Rasten
act_set = Einstellen
set_degrees = Auf Winkel ° (↺ +)
set_mark = Oder auf Marke
draw = Linie im Bild ziehen
draw_first = Auf dem Bildschirm des Geräts ziehen, oder klicken, wo die Linie beginnt.
draw_second = Jetzt klicken, wo die Linie endet.
line_by_numbers = Linie durch Zahlen
line_from = Von, mm auf der Front
line_to = Nach, mm auf der Front
line_use = Diese Linie nehmen
help_click = Den gewählten Drehknopf um Rasten drehen
help_draw = Eine Linie auf dem Berührbildschirm ziehen
action_double = Doppelt drücken
action_long = Lange drücken
action_drag = Ziehen
action_click = Rasten
moved_by = gesteuert von { $program }, Lebenszeichen von { $operator }
action_parameter = Parameter geändert:
action_set = Einstellen auf
seen_title = Auf der Front zu sehen
seen_none = Über Lampen, Drehknöpfe und Bildschirme ist nichts gemeldet.
hidden_stylus = hinter dem Stift
hidden_something = von etwas verdeckt
hidden_edge = nicht im Bild
lamp = Lampe { $colour }
lamp_off = aus
lamp_green = grün
lamp_red = rot
lamp_yellow = gelb
lamp_amber = bernsteinfarben
lamp_cyan = türkis
lamp_blue = blau
lamp_violet = violett
lamp_white = weiß
at_degrees = bei { $degrees }°
at_mark = auf { $mark } ({ $degrees }°)
changed_at = geändert { $time }
bad_gesture = Das geht nicht: { $what }
unknown_mark = Es gibt keine Marke { $mark }; es gibt: { $known }.
line_off_screen = Eine Linie beginnt auf einem Berührbildschirm; ({ $x_mm }; { $y_mm }) mm liegt daneben.
line_leaves_screen = Die Linie muss auf { $control } bleiben; ({ $x_mm }; { $y_mm }) mm liegt daneben.
line_short = Eine Linie von { $length_mm } mm ist zu kurz; mindestens { $limit_mm } mm.

tab_sequence = Ablauf
sequence = Ablauf
sequence_choice = Gespeicherter Ablauf
sequence_typed = – wie hier geschrieben –
sequence_text = Schritte, einer je Zeile
sequence_example = z. B. press:AUTO_SET => screen
sequence_collect = Tasten fügen hier einen Schritt an und bewegen nichts
sequence_check = Was nach einem angefügten Schritt zu sehen sein muss
check_none = ohne Prüfung
check_effect = eine Wirkung
check_screen = Bildschirm ändert sich
sequence_clear = Leeren
steps_back = Diese Schritte hat { $who } hier geschrieben ({ $time }); sie sind wieder da. Von selbst startet nichts.
steps_not_kept = Dieser Browser behält nichts: nach einem Neuladen sind diese Schritte weg.
sequence_added = Angefügt: { $step }
collecting = Die Seite sammelt Schritte (Reiter Ablauf): diese Tasten bewegen nichts.
sequence_start = { $count ->
    [one] { $count } Schritt beginnen
   *[other] { $count } Schritte beginnen
}
sequence_confirm = { $count ->
    [one] Bestätigen: { $count } Schritt
   *[other] Bestätigen: { $count } Schritte
}
sequence_steps = Schritte
sequence_nobody = Es läuft kein Programm für Abläufe.
sequence_empty = Es gibt noch keinen Schritt.
sequence_sent = { $all ->
    [one] Der Ablauf ({ $all } Schritt) ist gesendet, er hat noch nicht begonnen. STOP beendet ihn.
   *[other] Der Ablauf ({ $all } Schritte) ist gesendet, noch hat kein Schritt begonnen. STOP beendet ihn.
}
sequence_step = Schritt { $number } von { $all } in Arbeit. STOP beendet den Ablauf.
sequence_reached = { $all ->
    [one] { $name }: der Schritt ist erledigt.
   *[other] { $name }: alle { $all } Schritte sind erledigt.
}
sequence_aborted = { $name }: beendet. { $reason }
sequence_rejected = { $name }: abgelehnt. { $reason }
sequence_failed = { $name }: nicht gesendet. { $reason }
sequence_no_answer = { $name }: keine Antwort. { $reason }
step_waiting = nicht begonnen
step_work = in Arbeit
step_done = erledigt
step_failed = misslungen
step_unknown = unbekannt
action_sequence = Ablauf
sequence_unknown = Es gibt keinen gespeicherten Ablauf { $name }.
sequence_wrong = Der Ablauf ist falsch: { $what }
sequence_control = Schritt { $step }: diese Front hat kein { $control }.
sequence_runs = Ein Ablauf ist in Arbeit: { $step }

tab_teach = Anlernen
teach_hint = Macht eine neue Front bekannt: Bild festhalten, Ecken und Elemente anklicken, Beschreibung schreiben. Nichts bewegt sich.
teaching_no_action = Ein festgehaltenes Bild liegt über dem laufenden. Anlernen verlassen, um weiterzumachen.
teach_hold = Linkes Bild festhalten
teach_corners = Ecken der Front im Bild
corner_lower_left = Unten links
corner_lower_right = Unten rechts
corner_upper_right = Oben rechts
corner_upper_left = Oben links
teach_controls = Elemente, an ihrem Fuß
teach_click = Im Bild anklicken: { $name }
teach_all = Alles hat seinen Ort. Ein Klick versetzt: { $name }
teach_place = { $name }, { $axis } in Bildpunkten
teach_remove = { $name } entfernen
teach_name_label = Bezeichnung
teach_kind_label = Art
teach_w = Breite mm
teach_h = Höhe mm
teach_z = Steht vor mm
teach_add = Element anfügen
teach_model = Modell (Dateiname)
teach_title = Name für Menschen
teach_width = Breite der Front mm
teach_height = Höhe der Front mm
teach_write = Beschreibung schreiben
teach_working = Gesendet; die Erkennung sucht den Aufdruck …
teach_done = Geschrieben: { $layout } und { $template }. Start mit diesem Befehl:
teach_refused = Nichts geschrieben: { $reason }
teach_no_picture = Dieses Bild ist nicht mehr festgehalten. Noch einmal festhalten.
teach_name = { $field }: „{ $found }“ geht nicht; nötig sind Buchstaben von a bis z, Ziffern und _, wie in { $example }.
teach_kind = „{ $found }“ ist keines von { $known }.
teach_twice = Das Element { $control } gibt es zweimal.
teach_number = { $field } { $control } = { $found }: nötig sind { $low } bis { $high }.
teach_outside = Der Ort { $place } bei ({ $u }; { $v }) liegt außerhalb des Bildes von { $width } x { $height } Punkten.
field_model = Modell
field_control = Element
field_width = Breite in mm
field_height = Höhe in mm
field_controls = Anzahl der Elemente
field_proud = Überstand in mm
action_teach = Anlernen

### Programme des Graphen

## alignment

alignment-cameras_not_compared_limit_both = der letzte Vergleich der Kameras ist { $age_s } s alt (Grenze { $limit_s } s): sehen beide die Front?
alignment-degrees = { $turn_deg } Grad ({ $turn_px } px)
alignment-right_above_layout_limit_correct = { $control } ist { $x_mm } mm rechts und { $y_mm } mm über seiner Stelle in der Beschreibung (Grenze { $limit_mm } mm): die Beschreibung berichtigen
alignment-right_camera_moved_limit_degrees = die rechte Kamera hat sich um { $turn } gedreht (Grenze { $limit_deg } Grad): neu kalibrieren
alignment-right_camera_moving_calibration_not = die rechte Kamera bewegt sich: { $turn } seit ihrer Kalibrierung, noch nicht in Ruhe
alignment-touch_known_limit = die Berührung ist auf { $uncertainty_mm } mm bekannt (Grenze { $limit_mm } mm)

## axes

axes-axes_miss_right_angle_degrees = die Achsen verfehlen den rechten Winkel um { FIXED($degrees_deg, digits: 1) } Grad (Grenze { FIXED($degrees, digits: 1) })
axes-axis_moves_per_metre_reading = die Achse { $name } fährt { FIXED($scale_m, digits: 3) } m je Meter Ablesung (Grenzen { FIXED($max_scale_error, digits: 2) } bis { FIXED($max_scale_error_2, digits: 2) }): Schritte je mm und die Kamerakalibrierung prüfen
axes-not_go_they_should_one = x und y fahren falsch: eine Achse läuft rückwärts, oder beide sind vertauscht. Jede etwas fahren und ansehen, welche es ist, bevor Sie Motoren oder Einstellungen ändern
axes-stylus_leans_degrees_plausible_add = der Stift ist um { FIXED($degrees_deg, digits: 1) } Grad geneigt (Grenze { FIXED($degrees, digits: 1) }): Messungen mit mehr und weniger Stift aufnehmen
axes-stylus_moves_towards_panel_per = der Stift fährt { FIXED($depth_m, digits: 3) } m auf die Front zu je Meter Ablesung (Grenzen { FIXED($max_scale_error, digits: 2) } bis { FIXED($max_scale_error_2, digits: 2) }): Schritte je mm prüfen, oder Messungen mit mehr und weniger Stift aufnehmen
axes-stylus_not_go_they_should = Stift, x und y fahren falsch: x oder y läuft rückwärts, beide sind vertauscht, oder der Stift hebt sich, statt zu sinken. Jede Achse etwas fahren und ansehen, welche es ist, bevor Sie Motoren oder Einstellungen ändern

## board

board-lines_unanswered = { $reason }; { $lost ->
    [one] { $lost } Zeile unbeantwortet
   *[other] { $lost } Zeilen unbeantwortet
}
board-board_answered_out_turn_line = die Platine hat $G außer der Reihe beantwortet: eine Zeile oder eine Antwort ging auf der Leitung verloren oder kam doppelt
board-board_holds_bytes_under_way = die Platine hält { $held } Byte, { $in_flight_bytes } sind unterwegs: eine Antwort gehört zu keiner Zeile
board-board_reports_tell_no_machine = die Berichte der Platine nennen keine Maschinenposition: ${ $report_mask } ist { WORD($value) }, Bit 0 ({ $machine_position }) setzen
board-board_reset_itself_more_times = die Platine hat sich innerhalb von { FIXED($within_s, digits: 1) } s noch { $more }-mal selbst zurückgesetzt
board-board_taken_lines_not_answered = die Platine hat Zeilen genommen, die sie nicht beantwortet hat: eine Zeile oder ihre Antwort ging auf der Leitung verloren
board-cannot_read = { $text }: nicht lesbar ist { $decode }
board-no_answer_within_although_board = keine Antwort auf { $line } innerhalb von { SHORT($answer_within_s) } s, obwohl die Platine ruht

## bridge

bridge-no_driver_listens = kein Treiber hört zu
bridge-no_recognition_listens_could_taught = keine Erkennung hört zu, die eine Front lernen könnte
bridge-no_report_late = seit { FIXED($silent_s, digits: 0) } s keine Meldung, verspätet: { $names }
bridge-no_sequencer_listens = kein Ablaufgeber hört zu
bridge-record_could_not_written = die Brücke kann den Eintrag nicht schreiben: { $error }
bridge-reset_void = kein Zurücksetzen, die Maschine ist jetzt in einem anderen Zustand: { $state }
bridge-reset_waits = wartet, bis der Stop zu Ende und der Stift oben ist
bridge-service_not = der Dienst { $services } ist nicht da
bridge-stop_by_person = Stop: stopped_by_person, gedrückt von { $who }
bridge-stop_cause = Stop: { $cause }
bridge-stop_silent = Stop: { $cause }, seit { FIXED($silence_s, digits: 2) } s ohne Meldung (Grenze { FIXED($limit_s, digits: 2) } s)
bridge-stopped_before_went_out = gestoppt, bevor es hinausging

## calibration

calibration-part_with_note = { $done }/{ $total }, noch { FIXED($remaining_s, digits: 0) } s ({ $note })
calibration-part = { $done }/{ $total }, noch { FIXED($remaining_s, digits: 0) } s
calibration-failed = Kalibrierung misslungen: { $reason }
calibration-drifted = { $summary }; Abweichung: { $drift }
calibration-progress = kalibriert { $reason }
calibration-already_solve = es gibt schon { $max_contacts }; rechnen
calibration-base_reading_cannot_inverted = base_from_reading { $axes } ist nicht umkehrbar
calibration-below_0 = { $key } = { $document } liegt unter 0
calibration-calibrating_watch_state = kalibriert; auf den Zustand achten
calibration-calibration_already_running = eine Kalibrierung läuft schon
calibration-calibration_could_not_saved = die Kalibrierung lässt sich nicht sichern: { $error }
calibration-calibration_file_not_set = calibration_file ist nicht gesetzt
calibration-calibration_running = eine Kalibrierung läuft
calibration-calibration_use_refused = die benutzte Kalibrierung passt nicht: { $why }
calibration-camera_calibration_changed_meanwhile = die Kalibrierung der { WORD($side) } Kamera hat sich inzwischen geändert
calibration-camera_calibration_changed_since_made = die Kalibrierung der { $name } Kamera ist seitdem um { FIXED($change_px, digits: 2) } px anders
calibration-camera_info = camera_info: { $error }
calibration-camera_pictures_no_calibration = die Bilder der { WORD($side) } Kamera von { $width } x { $height_px } px haben keine Kalibrierung
calibration-cameras_carriage = , Kameras auf dem Wagen
calibration-driver_says = der Treiber meldet { $text }
calibration-driver_says_connected_homed_idle = der Treiber meldet { $driver }: er muss verbunden sein, seine Referenz haben und ruhen
calibration-finite_numbers_shape_needed = { $key } = { $given }: nötig sind endliche Zahlen der Form { WORD($shape) }
calibration-finite_point_needed = { $point } in { $frame }: nötig ist ein endlicher Punkt in { $panel }
calibration-format_needed = nötig ist Format { $format }
calibration-gantry_moved_but_seen_only = die Maschine fuhr { FIXED($along_mm, digits: 0) } mm, aber { WORD($what) }, wie sie zu sehen war, nur { FIXED($seen_mm, digits: 1) } mm: die Kameras verfolgen etwas anderes, die Kamera ist anders befestigt, oder der Antrieb rutscht. Vor der nächsten Fahrt das Bild ansehen
calibration-goal = das Ziel { WORD($where) } ist { WORD($outcome) }: { $reason }
calibration-goal_not_within = das Ziel ist innerhalb von { SHORT($waited_s) } s nicht { WORD($value) }
calibration-hand_eye_node_stopped = das Kalibrierprogramm ist beendet
calibration-hardly_leave_one_line = verlassen kaum eine Linie
calibration-held_out = , geprüft { FIXED($held_out_mm, digits: 2) } mm
calibration-held_out_place_off_accepted = an einer Prüfstelle lag die { WORD($what) } { FIXED($max_mm, digits: 2) } mm daneben (Grenze { FIXED($max_held_out_mm, digits: 2) } mm)
calibration-lie_one_line = liegen auf einer Linie
calibration-lowered_stylus_could_touch_panel = um { FIXED($least_mm, digits: 1) } mm gesenkt, könnte der Stift die Front berühren. Seine Spitze ist { FIXED($height_mm, digits: 1) } mm über ihr (das höchste Bedienelement und die Kugel nehmen davon { FIXED($proud_m, digits: 1) }). Das Gerät { FIXED($least_2_mm, digits: 1) } mm weiter weg stellen, oder run.heights_m und held_out_height_m verkleinern
calibration-lowered_tip_moved_check_stylus = um { FIXED($way_mm, digits: 1) } mm gesenkt, hat sich die Spitze um { FIXED($seen_mm, digits: 1) } mm bewegt: Schritte je mm des Stifts ($102) prüfen, ob er klemmt, und die Kamerakalibrierung
calibration-machine_settings_changed_since_made = die Einstellungen der Maschine sind seitdem andere: { $texts }
calibration-made_cameras_mounted_now = die Kameras waren dabei { $mounting } befestigt, jetzt { $mounting_2 }
calibration-made_machine_one = sie gilt für die Maschine { $machine }, diese ist { $machine_2 }
calibration-made_picture_now = sie ist für ein { $name } Bild von { $width } x { $height_px } px, jetzt hat es { $width_2 } x { $height_2_px } px
calibration-mapping_needed = { $key } = { $part }: nötig ist eine Zuordnung
calibration-missed = { $missed } ausgelassen
calibration-missing = { $key }: { $error } fehlt
calibration-mounting_fixed_carriage_needed = Befestigung { $mounting }: nötig ist 'fixed' oder 'carriage'
calibration-no_calibration_save = es gibt keine Kalibrierung zu sichern
calibration-no_camera_info_camera_arrived = von der { WORD($side) } Kamera kam keine camera_info
calibration-no_image_resting_machine_arrived = seit { FIXED($waited_s, digits: 1) } s kam kein Bild der ruhenden Maschine
calibration-no_image_resting_machine_evaluated = seit { FIXED($waited_s, digits: 1) } s ist kein Bild der ruhenden Maschine ausgewertet
calibration-not_hand_eye_calibration = { $path }: keine Hand-Auge-Kalibrierung: { $error }
calibration-now = { $k } war { $old_values }, jetzt { $new_values }
calibration-only_held_out_places_gave = nur { $checks } Prüfstellen gaben eine Messung, für die Prüfung sind 2 nötig
calibration-panel_seen_times_while_machine = die Kameras sahen die Front im Stillstand { $poses }- von { $panels }-mal
calibration-places_gave_no_sample_last = { $missed } von { $places } Stellen gaben keine Messung; zuletzt: { $why }
calibration-readings_not_differ_gantry_did = die Ablesungen unterscheiden sich nicht ({ FIXED($along_mm, digits: 2) } mm): die Maschine hat sich nicht bewegt; in x und y mindestens { FIXED($need_mm, digits: 0) } mm fahren
calibration-repetition = { $late }; Wiederholung { $step } von { $retries }
calibration-run_places_not_tell_calibration = die Orte des Laufs ergeben keine Kalibrierung: { $error }
calibration-sample_not_finite = eine Messung ist nicht endlich
calibration-sample_readings_stylus = Messung { $count } bei x = { FIXED($x, digits: 1) }, y = { FIXED($y, digits: 1) }, Stift = { FIXED($stylus_mm, digits: 1) } mm
calibration-samples_long_across_add_one = die Messungen { WORD($kind) } ({ FIXED($along_mm, digits: 0) } mm lang, { FIXED($across_mm, digits: 1) } mm breit): eine bei x = { FIXED($x, digits: 0) }, y = { FIXED($y_mm, digits: 0) } mm aufnehmen oder mindestens { FIXED($need_mm, digits: 0) } mm neben dieser Linie
calibration-samples_miss_one_another_rms = die Messungen verfehlen einander um { FIXED($rms_mm, digits: 2) } mm rms (Grenze { FIXED($max_rms_mm, digits: 2) } mm): prüfen, ob die Spitze gut zu sehen ist und nichts rutscht
calibration-samples_needed_move_another_place = { $samples } Messungen, nötig sind { $min_samples }: an eine andere Stelle fahren und aufnehmen
calibration-samples_not_fit_rest_numbers = { $left_out } von { $used } Messungen passen nicht zu den übrigen (Nummern { $numbers }): die Kameras haben die Spitze dort falsch gemessen, oder der Antrieb ist gerutscht; an anderen Stellen messen oder neu beginnen
calibration-samples_rms_predicted = { $samples } Stellen{ WORD($where) }, rms { FIXED($rms_mm, digits: 3) } mm{ $held }, vorhergesagt { FIXED($sigma_mm, digits: 3) } mm, { $made_at }
calibration-samples_too_close_together_move = die Messungen liegen zu dicht beieinander ({ FIXED($along_mm, digits: 1) } mm): in x und y mindestens { FIXED($need_mm, digits: 0) } mm fahren
calibration-saved = gesichert in { $path }
calibration-seen_too_late = es war zu spät zu sehen
calibration-stored_calibration_refused = die gespeicherte Kalibrierung passt nicht: { $error }
calibration-stylus_extension_changes_together_own = der Stift ändert sich mit x und y (eigener Teil { FIXED($ptp_mm, digits: 2) } mm): am selben x und y eine Messung mit { FIXED($min_stylus_span_mm, digits: 0) } mm mehr oder weniger Stift aufnehmen
calibration-tip = die Spitze
calibration-tip_nowhere_seen_both_cameras = nie sahen beide Kameras zugleich die Spitze. Sind links und rechts vertauscht, ist eine verkehrt herum oder unscharf, oder ist es eine andere Kugel? Einzelheiten nennt die Diagnose des Stiftverfolgers
calibration-tip_seen_times_while_machine = die Kameras sahen die Spitze im Stillstand { $tips }- von { $tips_2 }-mal
calibration-translation_most_possible = translation_m = { $shift }: möglich sind höchstens { SHORT($farthest_m) } m
calibration-waiting_camera_info_check_calibration = wartet auf camera_info, um die Kalibrierdatei zu prüfen
calibration-whole_number_0_needed = { $key } = { WORD($value) }: nötig ist eine ganze Zahl ab 0
calibration-z = x = { FIXED($x, digits: 0) }, y = { FIXED($y, digits: 0) }, z = { FIXED($z_mm, digits: 0) } mm

## carriage

carriage-contacts_1_needed = { $contacts } Kontakte, nötig sind 1 bis { $max_contacts }
carriage-contacts_miss_one_another_rms = die Kontakte verfehlen einander um { FIXED($rms_mm, digits: 2) } mm rms (Grenze { FIXED($contact_sigma_mm, digits: 2) } mm): prüfen, welche Stellen der Stift berührt hat
carriage-contacts_most_used_start_anew = { $contacts } Kontakte (Grenze { $max_contacts }): neu beginnen
carriage-nothing_tells_where_stylus_let = die Position des Stifts ist unbekannt: seine Spitze ins Bild der Kameras fahren, oder ein bis fünf bekannte Stellen berühren
carriage-only_points_panel_measured_needed = die Kameras haben bei x = { FIXED($reading, digits: 0) }, y = { FIXED($reading_mm, digits: 0) } mm nur { $pixels } Punkte der Front gemessen (mindestens { $min_points })
carriage-panel = die Front

## computer

computer-load_cores = Last { FIXED($load_average, digits: 1) } auf { $cores } Kernen, { $whole }: { $shares }
computer-none_needs_much = keines braucht viel
computer-robot_uses_other_programs = der Roboter nutzt { FIXED($robot_percent, digits: 0) } %, andere Programme { FIXED($others_percent, digits: 0) } %

## contact

contact-calibrate_again = { $cause }: neu kalibrieren
contact-not_known_whether_anything_touched = ob der Stift etwas berührt hat, ist nicht bekannt: die Kameras haben die Kugel im Kontakt nicht gemessen
contact-not_known_whether_anything_touched_2 = ob der Stift etwas berührt hat, ist nicht bekannt: { FIXED($beyond_mm, digits: 1) } mm unter der Fläche blieb die Kugel um { FIXED($lag_mm, digits: 2) } mm zurück
contact-nothing_touched_down_beyond_surface = bis { FIXED($beyond_mm, digits: 1) } mm unter der Fläche hat der Stift nichts berührt
contact-nothing_touched_driver_allows_ends = der Stift hat nichts berührt: die Grenze des Treibers liegt { FIXED($beyond_mm, digits: 1) } mm über der Oberfläche
contact-nothing_touched_late_images = keine Berührung mit verspäteten Bildern: { $delays }
contact-panel_higher_measured = die Front liegt { FIXED($off_mm, digits: 1) } mm höher als gemessen
contact-panel_lower_measured = die Front liegt { FIXED($off_mm, digits: 1) } mm tiefer als gemessen
contact-stylus_higher_readings_say = der Stift ist { FIXED($off_mm, digits: 1) } mm höher, als seine Anzeigen sagen
contact-stylus_lower_readings_say = der Stift ist { FIXED($off_mm, digits: 1) } mm tiefer, als seine Anzeigen sagen
contact-stylus_off_height_readings_say = der Stift weicht um { FIXED($off_mm, digits: 1, sign: 1) } mm von der Höhe seiner Anzeigen ab (Grenze { SHORT($limit_mm) } mm)
stylus-is_up = { $cause }; der Stift ist oben

## controller

controller-axes_2_2_values_within = Achsen { $matrix }: nötig sind 2 x 2 Werte, höchstens 0,1 von der Einheit entfernt
controller-busy = beschäftigt mit { $job }
controller-child_frame_needed = untergeordnetes System { $child_frame_id }, nötig ist { $base }
controller-clock_jumped_back = die Uhr sprang um { FIXED($jumped_back_s, digits: 1) } s zurück
controller-controller_ended = die Steuerung ist beendet
controller-controller_shutting_down = die Steuerung endet
controller-driver_motion = der Treiber hat die Bewegung { WORD($outcome) }: { $reason }
controller-error_controller = Fehler in der Steuerung: { $error }
controller-machine_told_stop = { $cause }; die Maschine soll anhalten
controller-no_reason_given = ohne Grund
controller-readings_most_home_believed = Ablesungen { $readings_m } m (Grenze { SHORT($farthest_m) } m vom Nullpunkt)
controller-stale_controller_held_up_allowed = veraltet: die Steuerung war { FIXED($held_s, digits: 1) } s lang aufgehalten (Grenze { SHORT($click_max_age_s) } s)

## drift

drift-none_any_more = alles ist wieder an seinem Platz zu sehen
drift-camera_machine_moved_calibrate_again = eine Kamera oder die Maschine hat sich bewegt: neu kalibrieren
drift-panel_corner = die Ecke der Front
drift-panel_moved_camera_look_calibrate = die Front oder eine Kamera hat sich bewegt; nachsehen, und neu kalibrieren, wenn es eine Kamera war
drift-seen_place_calibration = { $control } ist { FIXED($control_mm, digits: 1) } mm neben der Stelle bei der Kalibrierung zu sehen
drift-tip_seen_calibrated_place = die Spitze ist { FIXED($tip_mm, digits: 1) } mm neben ihrer kalibrierten Stelle zu sehen

## driver

driver-accepted = angenommen
driver-stopping = hält an
driver-disabled = gesperrt
driver-enabled = freigegeben
driver-accepted_homing = angenommen: Referenzfahrt
driver-accepted_reset = angenommen: zurückgesetzt
driver-accepted_writing_configured_settings_they = angenommen: der Treiber schreibt die Einstellungen der Konfiguration und liest sie zurück
driver-driver_ending = der Treiber endet
driver-not_opened_yet = noch nicht geöffnet
driver-refused = verweigert: { $refusal }
driver-stop_requested = Stop verlangt
driver-thread_guard_ended = die Verbindung zum Schutzprogramm ist beendet
driver-trajectory_bytes_limit = die Bahn hat { $data } Bytes (Grenze { $max_bytes })

## effect

effect-clicks_degrees_more_whole_turn = { SHORT($argument) } Rasten zu { SHORT($detent_deg) } Grad sind mehr als eine ganze Drehung
effect-lamp = Lampe { WORD($lamp) } -> { WORD($lamp_2) }
effect-no_clicks_detent_deg_layout = { $name } hat keine Rasten (detent_deg in der Beschreibung)
effect-no_mark = { $name } hat keine Marke { $mark }; es gibt { $marks }
effect-none_seen = keine gesehen
effect-nothing_seen_needs_recognition_state = von { $name } ist nichts zu sehen: { WORD($kind) } braucht, was die Erkennung von der Front meldet
effect-screen_changed = Bildschirm geändert

## face

face-both_cameras_together_see_panel = beide Kameras zusammen sehen die Front { FIXED($height_mm, digits: 1) } mm { WORD($side) } als ihren Aufdruck (Grenze { SHORT($bound_mm) } mm): die Front nachmessen (size_mm ihrer Beschreibung). Ist eine Kamera vielleicht verdreht, das Paar neu kalibrieren
face-face_too_little_print_recognised = die Front von { $model } hat zu wenig Aufdruck für die Erkennung
face-further_away = weiter weg

## gesture

gesture-angle_degrees_not_zero_most = einen Winkel in Grad, nicht null, höchstens 360 in jede Richtung
gesture-command_characters_most_allowed = der Befehl hat { $text } Zeichen (Grenze { $max_length })
gesture-drag_needs_found = drag braucht { $drag }, gefunden: { $text }
gesture-expected_gesture_target_gesture_target = { $body }: erwartet Geste:Ziel oder Geste:Ziel:Argument
gesture-expected_id_up_64_letters = { $tail }: erwartet id= und bis zu 64 Buchstaben, Ziffern, '.', '-' oder '_'
gesture-gesture_none = Geste { WORD($kind) } ist keine von { $gestures }
gesture-marked_position_name_degrees_180 = den Namen einer Marke oder Grad von -180 bis 180
gesture-needs_found = { WORD($kind) } braucht { $needs }, gefunden: { $parts }
gesture-needs_found_nothing = { WORD($kind) } braucht { $needs }, gefunden: nichts
gesture-not_finite = { WORD($what) } { $text } ist nicht endlich
gesture-not_number = { WORD($what) } { $text } ist keine Zahl
gesture-point_where_ends = den Endpunkt x,y@frame
gesture-seconds_above_0_up_30 = Sekunden über 0 bis 30
gesture-takes_no_argument_found = { WORD($kind) } hat kein Argument, gefunden: { $parts }
gesture-target_neither_control_name_nor = Ziel { $text } ist weder der Name eines Elements noch x,y@frame
gesture-whole_number_clicks_not_zero = eine ganze Zahl von Rasten, nicht null, höchstens { $max_clicks } in jede Richtung

## goal

goal-command = Befehl
goal-goal = Ziel
goal-cameras_beside = Kameras daneben
goal-corrected_aim = korrigiertes Ziel: { $error }
goal-degrees = { $knob } bei { FIXED($angle_deg, digits: 1, sign: 1) } Grad
goal-driver_reports_end_motion_beside = die Bewegung endete { FIXED($off_mm, digits: 2) } mm neben dem Ziel (Grenze { SHORT($arrival_tolerance_mm) } mm)
goal-frame_none = Koordinatensystem { $frame } ist keines von { $frames }
goal-goal_waits = das Ziel wartet darauf
goal-image_controls_recognition_evaluated = Bild, das die Erkennung ausgewertet hat
goal-image_stylus_tracker_evaluated = Bild, das der Stiftverfolger ausgewertet hat
goal-late_limit = verspätet: { WORD($what) }, { FIXED($measured_s, digits: 2) } s (höchstens { SHORT($limit_s) } s)
goal-looking_effect = schaut nach der Wirkung
goal-looking_tip = schaut auf die Spitze
goal-marker = Markierung von { $name }
goal-marker_not_seen_within = die Marke von { $knob } war innerhalb von { SHORT($wait_s) } s nicht zu sehen
goal-move = fahren nach ({ SHORT($x) }; { SHORT($y) }; { SHORT($z) }) m in { $base }
goal-moving_above_target = fährt über das Ziel
goal-moving_back_above_target = fährt zurück über das Ziel
goal-moving_out_way = fährt aus dem Weg
goal-moving_point = fährt zur Stelle
goal-moving_seen_error = fährt um den gesehenen Fehler
goal-moving_up = fährt hoch
goal-moving_up_after_fault = fährt nach einem Fehler hoch
goal-needs_knob_name_found = { WORD($kind) } braucht den Namen eines Drehknopfs, gefunden: { $gesture }
goal-next_turn_stylus_up = die nächste Drehung: { $error }; der Stift ist oben
goal-no_more_motion_ordered = { $cause }; keine weitere Bewegung
goal-no_result_motion_driver = seit { FIXED($wait_s, digits: 1) } s kein Ergebnis der Bewegung vom Treiber
goal-not_picture = { $control } ist nicht im Bild
goal-not_seen_nothing_read_panel = nicht gesehen: seit der Berührung war { FIXED($for_s, digits: 1) } s lang von der Front nichts zu lesen
goal-nothing_moved = { $error }; nichts hat sich bewegt
goal-nothing_seen_most_allowed_try = die Erkennung hat { $name } { $since } nicht gesehen (Grenze { SHORT($limit_s) } s): noch einmal versuchen, oder ist der Rechner überlastet?
goal-nothing_seen_panel_state_effect = vom Zustand der Front ist nichts zu sehen: die Wirkung von { WORD($kind) } muss es sein (require_effect)
goal-point_not_finite = Punkt ({ $xyz }) ist nicht endlich
goal-press = drücken ({ SHORT($x) }; { SHORT($y) }) { WORD($unit) } in { $frame }
goal-sent_again_try = die Steuerung sendet sie noch einmal, Versuch { $sent } von { $slow_tries }
goal-something_hand_still_hides_after = etwas (eine Hand?) verdeckt { $control } noch nach { SHORT($hidden_wait_s) } s
goal-stale_stamp_old_allowed = veraltet: der Stempel ist { FIXED($age_s, digits: 3) } s alt (Grenze { SHORT($goal_max_age_s) } s)
goal-stamp_future_clocks_agree = { $reason }; der Stempel ist aus der Zukunft: stimmen die Uhren überein?
goal-stands_degrees_off_after_turns = { $knob } steht nach { $turns } Drehungen { FIXED($off_deg, digits: 1) } Grad daneben (Grenze { SHORT($allowed) }); der Stift ist oben
goal-stylus_gone_down_look_panel = der Stift hat schon berührt: vor einem neuen Versuch die Front ansehen; { $reason }
goal-stylus_may_bent_another_one = { $cause }; der Stift kann verbogen oder ein anderer sein; nichts hat sich bewegt
goal-then = { $cause }; dann { $more }
goal-tip_measured_beside_target_could = die Kameras haben die Spitze neben dem Ziel gemessen, weil sie über dem Ziel verdeckt war
goal-touched_but_effect_stylus_up = berührt, aber die Wirkung war { $unread }; der Stift ist oben
goal-touched_but_no_effect_seen = berührt, aber innerhalb von { SHORT($wait_s) } s war keine Wirkung zu sehen; der Stift ist oben
goal-touched_but_not_confirmed_stylus = berührt, aber nicht bestätigt: { $finding }; der Stift ist oben
goal-touched_but_not_measured_no = berührt, aber nicht gemessen: { $since } hat der Stiftverfolger kein Bild ausgewertet
goal-touching_down = setzt auf
goal-touching_looking_contact = berührt: schaut auf den Kontakt
goal-touching_turning = berührt: dreht
goal-waiting_free_view = wartet auf freie Sicht
goal-waiting_panel_seen = wartet, bis die Front zu sehen ist
goal-waiting_pictures_contact = wartet auf die Bilder der Berührung
goal-waiting_up = warten bis zu { SHORT($limit_s) } s
goal-z_above_0_where_stylus = z = { SHORT($xyz_m) } m (Grenze 0, der eingezogene Stift)
goal-z_must_0_surface_found = z = { SHORT($z) } in { $frame } muss 0 sein: die Fläche folgt aus der Front
goal-z_stylus_can_only_up = z = { SHORT($xyz_m) } m: dieser Stift kann nur oben sein, 0, oder berühren
goal-z_touch_panel_lowest_use = z = { FIXED($goal_m, digits: 4) } m würde dort die Front berühren (Grenze { FIXED($lowest_m, digits: 4) } m); zum Berühren press benutzen

## grbl

grbl-alarm = ALARM:{ $code } ({ $texts })
grbl-allowed_only_while_idle = nur in Ruhe erlaubt
grbl-arc_offsets = Mittelpunkt des Bogens
grbl-arc_radius = Radius des Bogens
grbl-arc_target = Ziel des Bogens
grbl-arc_without_axis_word_plane = Bogen ohne Achswort seiner Ebene
grbl-axis_words_without_use = Achswörter ohne Verwendung
grbl-bad_jog = falsche Fahranweisung
grbl-bad_number = falsche Zahl
grbl-command_not_supported = Befehl nicht unterstützt
grbl-control_limit_input_active_start = beim Start ist ein Eingang oder Endschalter aktiv
grbl-coordinate_system_beyond_g_59 = Koordinatensystem jenseits von G59
grbl-eeprom_read_failed = EEPROM nicht lesbar
grbl-emergency_stop_pressed = der Not-Halt ist gedrückt
grbl-emergency_stop_second_axis = Not-Halt oder zweite Achse
grbl-error = Fehler { $code } ({ $error_texts })
grbl-g_43_1_takes_axis = G43.1 nimmt nur die Achse des Werkzeugs
grbl-g_53_needs_g_0 = G53 braucht G0 oder G1
grbl-hard_limit_switch_position_lost = Endschalter, Position verloren
grbl-hard_stop = harter Halt
grbl-homing_door_opened = Referenzfahrt: Tür geöffnet
grbl-homing_no_switch_found = Referenzfahrt: keinen Schalter gefunden
grbl-homing_not_enabled = Referenzfahrt ist nicht eingeschaltet ($22)
grbl-homing_pull_off_did_not = Referenzfahrt: der Schalter blieb beim Freifahren gedrückt
grbl-homing_reset_during_cycle = Referenzfahrt: dabei zurückgesetzt
grbl-homing_switch_not_clear = Referenzfahrt: unklar, welcher Schalter
grbl-integer_expected = ganze Zahl erwartet
grbl-jog_beyond_travel = Fahrt über den Weg hinaus
grbl-laser_mode_needs_pwm = Laserbetrieb braucht PWM
grbl-letter_expected = Buchstabe erwartet
grbl-limit_switch_engaged = ein Endschalter ist gedrückt
grbl-limit_switch_engaged_only_homing = ein Endschalter ist gedrückt, nur die Referenzfahrt ist erlaubt
grbl-line_length = Zeile { $text } hat mit dem Zeilenende { $size } Byte (Grenzen 2 bis { $limit })
grbl-line_column_cannot_part_line = Zeile { $text }, Spalte { $column }: { $char } kann nicht Teil einer Zeile sein
grbl-line_number_out_range = Zeilennummer außerhalb des Bereichs
grbl-line_too_long = Zeile zu lang
grbl-locked_alarm = durch einen Alarm gesperrt
grbl-motor_fault = Fehler eines Motors
grbl-must_homed_first = braucht zuerst die Referenzfahrt
grbl-no_axis_words = keine Achswörter
grbl-no_feed_rate = kein Vorschub
grbl-probe_did_not_make_contact = Taster fand keinen Kontakt
grbl-probe_not_initial_state = Taster nicht in der Ausgangslage
grbl-reset_signal_held_fluidnc_no = ein Rücksetzsignal liegt an, oder bei FluidNC hat keine Achse eine Referenzfahrt
grbl-reset_while_moving_position_lost = in Bewegung zurückgesetzt, Position verloren
grbl-safety_door_open = Schutztür offen
grbl-see_manual_firmware = siehe das Handbuch der Firmware
grbl-soft_limits_need_homing = Grenzen brauchen eine Referenzfahrt
grbl-spindle_fault = Fehler der Spindel
grbl-spindle_not_speed = die Spindel hat ihre Drehzahl nicht erreicht
grbl-statement_not_known = $-Anweisung nicht bekannt
grbl-step_pulse_shorter_3_us = Schrittimpuls kürzer als 3 µs
grbl-step_rate_above_firmware_maximum = Schrittrate über dem Höchstwert der Firmware
grbl-target_beyond_soft_limits = Ziel außerhalb der Grenzen
grbl-too_long_stored = zu lang zum Speichern
grbl-tool_number_too_large = Werkzeugnummer zu groß
grbl-two_commands_one_modal_group = zwei Befehle einer modalen Gruppe
grbl-two_commands_use_axis_words = zwei Befehle brauchen die Achswörter
grbl-unused_value_words = unbenutzte Wertwörter
grbl-value_must_not_negative = der Wert darf nicht negativ sein
grbl-value_word_missing = Wertwort fehlt
grbl-word_given_twice = Wort steht zweimal da

## guard

guard-points_to = { $points } Punkte nach { $place }
guard-another_configuration = eine andere Konfiguration
guard-before_hello = { $name } vor der Anmeldung
guard-closed_after_stop_machine_state = { SHORT($within_s) } s nach dem Stopp geschlossen: der Zustand der Maschine ist unbekannt, der Stift ist vielleicht unten
guard-driver_node_ended = das Treiberprogramm läuft nicht mehr
guard-driver_node_sends_too_much = das Treiberprogramm sendet zu viele Daten
guard-driver_node_sent_unreadable_message = das Treiberprogramm hat eine unlesbare Nachricht gesendet: { $error }
guard-driver_node_silent = das Treiberprogramm meldet sich seit { FIXED($silent_s, digits: 2) } s nicht
guard-frame_bytes_limit = die Nachricht hat { $data } Bytes (Grenze { $max_frame_bytes })
guard-frame_not_json = die Nachricht ist kein JSON: { $error }
guard-frame_not_json_object = die Nachricht ist kein JSON-Objekt
guard-guard = Schutzprogramm: { $error }
guard-guard_ended = das Schutzprogramm läuft nicht mehr
guard-guard_ending = das Schutzprogramm endet
guard-guard_hangs_restarted = das Schutzprogramm hängt; der Treiber startet es neu
guard-guard_not_answer = das Schutzprogramm antwortet nicht
guard-link_lost = Leitung verloren: { $reason }
guard-points = { $points } Punkte
guard-use_another_program_while_driver = von einem anderen Programm belegt, etwa von einem laufenden Treiber

## hold

hold-homing = Referenzfahrt
hold-driver_connecting = Treiber verbindet
hold-driver_disconnected = Treiber getrennt
hold-driver_idle_needed = der Treiber ist { $driver }, er muss ruhen
hold-driver_moving = der Treiber bewegt etwas
hold-no_joint_states = keine Gelenkwerte
hold-no_joint_states_most_allowed = { $since } keine joint_states (Grenze { SHORT($joints_timeout_s) } s)
hold-no_operator_heartbeat = kein Bediener (Herzschlag)
hold-no_operator_heartbeat_most_allowed = { $since } kein Herzschlag des Bedieners (Grenze { SHORT($heartbeat_timeout_s) } s)
hold-no_picture_left_camera = kein Bild von der linken Kamera
hold-no_picture_left_camera_most = { $since } kein Bild von der linken Kamera (Grenze { SHORT($camera_timeout_s) } s)
hold-not_calibrated = nicht kalibriert
hold-not_enabled = nicht freigegeben
hold-not_homed = keine Referenz
hold-settings_mismatch = Einstellungen stimmen nicht
hold-stop_asked = { $text }, ein Stop ist verlangt
hold-stylus_last_extended_may_still = der Stift war zuletzt um { FIXED($last_mm, digits: 1) } mm ausgefahren und drückt vielleicht noch: die Referenzfahrt hebt ihn

## homing

homing-after_homing_board = nach der Referenzfahrt ist die Platine { $state_text }
homing-board_must_homed_before_takes = die Platine nimmt vor der Referenzfahrt keine Zeile an (${ $number } ist { WORD($value) }), der Treiber muss den Stift aber vorher heben: ${ $number_2 } auf 1 setzen, wie es gantry/write_settings tut
homing-driver = der Treiber ist { $state_text }
homing-homed_mpos_configuration_says = Referenz bei MPos { $found_mm } mm; erwartet { $expected_mm } mm (Konfiguration)

## inputs

inputs-calibration_withdrawn = die Kalibrierung gilt nicht mehr
inputs-camera_stalled_no_picture = die Kamera steht: { $since } kein Bild
inputs-controller_started_stylus_extended = die Steuerung begann mit um { FIXED($here_mm, digits: 1) } mm ausgefahrenem Stift
inputs-driver = der Treiber ist { $driver }
inputs-lost_operator_no_heartbeat = Bediener verloren: { $age } kein Herzschlag
inputs-no_joint_states = { $since } keine Gelenkwerte
inputs-no_pose_panel_recognition_late = { $since } keine Lage der Front: die Erkennung ist verspätet
inputs-nothing_heard_driver = vom Treiber ist nichts zu hören
inputs-panel_moved_target_allowed = die Front hat sich am Ziel um { FIXED($moved_mm, digits: 1) } mm bewegt (Grenze { SHORT($panel_moved_mm) } mm)
inputs-panel_not_recognised_most_allowed = die Front ist { $since } nicht erkannt (Grenze { SHORT($panel_max_age_s) } s): ist etwas davor, oder ist zu wenig Licht?
inputs-pose_panel = Lage der Front
inputs-something_hand_hidden = etwas (eine Hand?) verdeckt { $control } seit { FIXED($hidden_s, digits: 1) } s

## json

json-integer_digits_too_large = eine ganze Zahl mit { $text } Ziffern ist zu groß
json-key_stands_twice = ein Schlüssel steht zweimal da
json-not_json = { $text } ist kein JSON
json-object_needed_not = nötig ist ein Objekt, nicht { $name }
json-too_large = { $text } ist zu groß

## layout

layout-artwork_needs_one_rectangle_circle = artwork braucht eines von rectangle_mm, circle_mm, line_from_to_mm, text
layout-circle_radius_above_0_needed = circle_mm = { $circle_mm }: nötig ist ein Radius über 0
layout-control_reaches_outside_panel = Element { $control } bei ({ SHORT($x) }; { SHORT($y) }) reicht über die Front { SHORT($width) } x { SHORT($height_mm) } mm hinaus
layout-control_stands_twice = Element { $control } steht zweimal da
layout-depth_not_below_knob_height = depth_mm = { SHORT($depth) } ist nicht kleiner als height_mm = { SHORT($proud_mm) } des Drehknopfs
layout-detent_deg_not_within_0 = detent_deg = { SHORT($detent) } liegt nicht zwischen 0 und 180 Grad
layout-detent_deg_remove_key_knob = detent_deg = { SHORT($detent) }: diesen Schlüssel bei einem Knopf ohne Rasten entfernen
layout-dimple_lies_knob_middle_0 = die Mulde liegt { SHORT($hypot) } bis { SHORT($reach_mm) } mm von der Mitte des Drehknopfs, möglich sind 0 bis { SHORT($knob_mm) } mm
layout-dimple_mapping_place_diameter_depth = dimple = { $given }: nötig sind place_mm, diameter_mm und depth_mm
layout-height_not_within_0_200 = height_mm = { SHORT($proud) } liegt nicht zwischen 0 und 200 mm
layout-id_markers_0 = id = { $entry }: { $dictionary } hat die Marken 0 bis { $count }
layout-knob_knob_circle = Drehknopf { $name } ist { WORD($shape) }; ein Drehknopf ist ein Kreis
layout-mark_letter_z_then_letters = Marke { $name }: nötig ist ein Buchstabe von A bis Z, dann Buchstaben, Ziffern und '_', und weder nan noch inf, die Zahlen sind
layout-mark_not_within_180_180 = Marke { $name } = { SHORT($degrees) } liegt nicht zwischen -180 und 180 Grad
layout-marker_stands_twice = Marke { $marker } steht zweimal da
layout-marker_white_rim_under_control = Marke { $marker } mit ihrem weißen Rand liegt unter Element { $control }
layout-marker_white_rim_wide = Marke { $marker } bei ({ SHORT($x) }; { SHORT($y) }) mit ihrem weißen Rand, { FIXED($side_mm, digits: 1) } mm breit,
layout-marks_deg_mapping_names_degrees = marks_deg = { $given }: nötig ist eine Zuordnung von Namen zu Grad
layout-n_1_mapping_model_size_controls = { $file_name }:1: nötig ist eine Zuordnung mit model, size_mm und controls
layout-name_letter_z_then_letters = Name { $name }: nötig ist ein Buchstabe von A bis Z, dann Buchstaben, Ziffern und '_'
layout-no_control = { $model } hat kein Element { $name }; es gibt { $controls }
layout-no_controls = keine Bedienelemente
layout-only_knob_detent_deg_marks = { $name } ist: { WORD($kind) }; detent_deg, marks_deg oder eine Mulde (dimple) hat nur ein Drehknopf
layout-reaches_outside_panel = { $text } reicht über die Front { SHORT($size_mm) } x { SHORT($size_2_mm) } mm hinaus
layout-rectangle_width_height_above_0 = rectangle_mm = { $rectangle_mm }: nötig sind Breite und Höhe über 0
layout-size_circle_wide_high = size_mm = [{ SHORT($width) }, { SHORT($height) }]: ein Kreis ist so breit wie hoch
layout-tolerance_not_within_0 = tolerance_mm = { SHORT($value) } liegt nicht zwischen 0 und { SHORT($max_tolerance_mm) } mm

## link

link-asking_build = nach der Firmware fragte
link-board_power_port = { $text }: hat die Steuerung Strom, und ist { $port } ihr Anschluss?
link-board_reports = die Platine meldet { $state_text }, { $question }?
link-bytes_came_no_grbl_line = { $text }: { $heard_bytes } Bytes kamen an, die nicht von einem GRBL sind: ist { $baud } ihre Datenrate (baud), oder ist an { $port } ein anderes Gerät?
link-device_gone = das Gerät ist nicht mehr da
link-error_driver = Fehler im Treiber: { $error }
link-firmware_grbl_before_1_1 = die Firmware ist ein GRBL vor 1.1, dessen Meldungen eine andere Form haben; nötig ist 1.1
link-firmware_marlin_no_feed_hold = die Firmware ist Marlin, die keinen Vorschubhalt kennt; nötig ist GRBL
link-hold_button_pressed = ist ihre Halt-Taste gedrückt
link-no_answer_while = keine Antwort in { SHORT($connect_timeout_s) } s, während der Treiber { $waiting_for }
link-reading_settings = die Einstellungen las
link-reports_feed_min_limit_min = sie meldet einen Vorschub von { FIXED($feed_mm_min, digits: 0) } mm/min (Grenze { FIXED($feed_limit_mm_min, digits: 0) } mm/min)
link-reports_mpos_off_limit = sie meldet MPos { $place_mm } mm, { FIXED($off_mm, digits: 2) } mm daneben (Grenze { SHORT($tube_mm) } mm)
link-safety_door_open = ist ihre Schutztür offen
link-waiting_banner = auf die Begrüßung wartete
link-writing_settings = die Einstellungen schrieb

## machine

machine-board_not_answered_within_may = die Platine hat $I nicht innerhalb von { SHORT($build_within_s) } s beantwortet und macht vielleicht eine Referenzfahrt: der Treiber setzt sie zurück
machine-homing_answered_after_board_not = die Platine hat die Referenzfahrt nach { FIXED($latency_s, digits: 2) } s beantwortet, sie also nicht ausgeführt
machine-homing_refused = Referenzfahrt verweigert: { $text }
machine-homing_took_longer = die Referenzfahrt dauerte länger als { SHORT($homing_timeout_s) } s
machine-line = { $error_text } in Zeile { $number } { $line }
machine-no_banner_within_reset = keine Begrüßung innerhalb von { SHORT($banner_timeout_s) } s nach einem Zurücksetzen
machine-no_status_report = seit { FIXED($silent_s, digits: 1) } s kein Statusbericht
machine-refused = die Platine lehnt { $line } ab: { $text }
machine-stylus_left_extended_allowed = der Stift blieb { FIXED($rested_s, digits: 1) } s lang ausgefahren (Grenze { SHORT($allowed_s) } s)
machine-stylus_not_lifted = die Platine hat den Stift nicht gehoben: { $text }
machine-stylus_not_lifted_time = die Platine hat den Stift nicht rechtzeitig gehoben

## markers

markers-marker_panel_where_print_allowed = nach Marke { $known } ist die Front { FIXED($apart_mm, digits: 1) } mm von ihrem Aufdruck entfernt (Grenze { SHORT($bound_mm) } mm)
markers-marker_where_layout = Marke { $dictionary } { $id } ist, wo die Beschreibung { $other } hat

## motion

motion-lies_outside = { $name } = { FIXED($value_m, digits: 4) } m liegt außerhalb von { FIXED($low, digits: 4) } bis { FIXED($high_m, digits: 4) } m

## operator

operator-gantry_controller_sent_no_sign = gantry_controller hat seit { FIXED($silent_s, digits: 1) } s kein Zeichen zu seinem Ziel gesendet

## page

page-drawn_camera_layers_true_false = erwartet drawn, oder camera und Ebenen (true oder false)
page-simulated_time_stood_still_bench = die simulierte Zeit steht seit { SHORT($silent_s) } s: Der Prüfstand, oder ein Programm, auf das er wartet, ist verspätet

## panel

panel-degrees = bei { FIXED($angle_deg, digits: 1, sign: 1) } Grad
panel-hidden = verdeckt von { WORD($hidden_by) }
panel-lamp = Lampe { WORD($lamp) }
panel-line_sight_not_meet_panel = der Blick trifft die Front nicht von vorn
panel-no_pose_panel_most_allowed = { $since } keine Lage der Front (Grenze { SHORT($panel_max_age_s) } s)
panel-none_panel_markers_seen_yet = keine Kamera hat bisher die Marken der Front gesehen
panel-not_picture = nicht im Bild
panel-panel_not_recognised = Front nicht erkannt
panel-panel_not_recognised_no_yet = die Front ist nicht erkannt: bisher keine { WORD($missing) }
panel-panel_not_seen_where_cameras = die Kameras haben die Front aus ihrer neuen Lage noch nicht gesehen (Grenze { SHORT($look_timeout_s) } s)
panel-panel_plane_being_measured = die Messung der Ebene der Front läuft
panel-panel_plane_being_measured_driver = die Messung der Ebene der Front läuft, der Treiber kennt sie noch nicht
panel-panel_pose_old = Lage der Front ist veraltet
panel-panel_recognised_confidence_least_needed = die Sicherheit der Erkennung der Front ist { FIXED($confidence, digits: 2) } (mindestens { SHORT($min_confidence) })
panel-stylus = dem Stift
panel-unknown_control_nearest = unbekanntes Element { $name }; am ähnlichsten: { $near }

## path

path-joint_names_some_each_once = Gelenknamen { $names }: nötig sind einige von { $joints }, jeder einmal
path-point_between_up_0_down = Punkt { $number }: { $joints } = { SHORT($z_m) } m liegt zwischen oben, 0, und unten, { SHORT($down_m) } m, den einzigen Stellungen bei { WORD($kind) }: hält der Absender ihn für eine Z-Achse (stylus_two_positions der Steuerung)?
path-point_min_above_min = Punkt { $number }: { $joints } mit { FIXED($rate, digits: 0) } mm/min ist schneller als { SHORT($limit) } mm/min
path-point_not_finite = Punkt { $number }: { $joints } = { WORD($value) } ist nicht endlich
path-point_outside_0 = Punkt { $number }: { $joints } = { SHORT($value_m) } m liegt außerhalb von 0 bis { SHORT($limit_m) } m
path-point_positions_joints = Punkt { $number } hat { $positions_m } Positionen für { $order } Gelenke
path-point_time_start_negative = Punkt { $number }: time_from_start { SHORT($time_s) } s ist negativ
path-point_time_start_not_follow = Punkt { $number }: time_from_start { SHORT($time_s) } s folgt nicht auf { SHORT($clock_s) } s
path-point_velocities_time_not_finite = Punkt { $number }: Geschwindigkeiten { $velocities_m_s } oder Zeit { $time_s } sind nicht endlich
path-trajectory_points_1_needed = die Bahn hat { $points } Punkte, nötig sind 1 bis { $max_points }

## proof

proof-board_feed_override_rises_although = die Vorschubanpassung der Platine steigt auf { SHORT($feed_percent) } %, obwohl der Treiber sie zurücksetzt
proof-board_left_path = die Platine hat den Weg verlassen: { $deviation }
proof-board_overrides_feed_spindle_set = die Übersteuerung der Steuerung stand auf { SHORT($feed_percent) } % (Vorschub) und { SHORT($spindle_percent) } % (Spindel): auf 100 % zurückgesetzt
proof-board_reports_work_offset_instead = die Platine meldet den Werkstückversatz { $found_mm } mm statt { $wanted_mm } mm
proof-board_reset_itself_position_lost = die Platine hat sich selbst zurückgesetzt, ihre Position ist verloren
proof-board_stands_elsewhere_without_command = die Platine steht ohne einen Befehl von hier anderswo, ihre Position ist verloren
proof-board_stands_instead_off = die Platine steht bei { $metres } statt bei { $metres_2 }, { FIXED($error_mm, digits: 2) } mm daneben
proof-cameras_show_stylus_above_panel = die Kameras zeigen den Stift { FIXED($height_mm, digits: 1) } mm über der Front: er drückt nichts
proof-motion_taken_limit_twice_expected = die Bewegung dauert schon { FIXED($took_s, digits: 1) } s (Grenze { FIXED($limit_s, digits: 1) } s, das Doppelte der erwarteten Zeit)
proof-shows_no_after = $G zeigt nach { $lines } kein { WORD($missing) }: { $modes_text }

## recognition

recognition-picture_camera_calibration = das Bild hat { $shape_px } px, die Kalibrierung der Kamera { $size }
recognition-picture_values_uint_8_needed = das Bild hat Werte von { $dtype }, nötig ist uint8

## record

record-already_recording = zeichnet schon auf nach { $output }
record-bag_record_ended = bag_record endete mit { $returncode }
record-bag_record_not_installed_beside = bag_record ist neben diesem Programm nicht installiert
record-being_finished_already = bag_record schließt { $output } schon ab
record-cannot_record = kann nicht nach { $output } aufzeichnen: { $error }
record-nothing_being_recorded = keine Aufzeichnung läuft
record-record_folder_empty_nothing_recorded = record_folder ist leer: diese Brücke zeichnet nichts auf
record-recorded = aufgezeichnet in { $summary }
record-recording = zeichnet auf nach { $output }

## request

request-one_of = eines von { $choices }
request-either_control_point_line = entweder ein Element, eine Stelle oder eine Linie
request-four_corners = vier Ecken
request-integer_0_2_53 = eine ganze Zahl von 0 bis 2^53
request-length_most_1000 = eine Länge von höchstens 1000 mm
request-list = eine Liste
request-n_1_0_1 = -1, 0 oder 1
request-n_1_texts = 1 bis { $max_steps } Texte
request-nanoseconds_text_digits = Nanosekunden als Text aus Ziffern
request-needed = { $name } = { WORD($value) }: nötig ist { $needed }
request-number = eine Zahl
request-numbers = { $length } Zahlen
request-text_up_300_characters_each = ein Text von bis zu 300 Zeichen, die alle zu sehen sind
request-text_up_64_characters = ein Text von bis zu 64 Zeichen
request-texts_numbers = { $texts } Texte und { $length } Zahlen
request-unknown_field = unbekanntes Feld { $raw }

## sequence

sequence-nothing = nichts
sequence-unlike = { $check } ({ $instead })
sequence-busy = beschäftigt mit { $run_id }, { $state }
sequence-check_none = { $place }: Prüfung { $text } ist keine von { $known }
sequence-check_text_list_texts_needed = { $place }: check = { $checks }: nötig ist ein Text oder eine Liste von Texten
sequence-controller_neither_taken_nor_refused = die Steuerung hat ihn innerhalb von { SHORT($accept_s) } s weder angenommen noch abgelehnt
sequence-controller_rest_without_answer = die Steuerung ruht seit { SHORT($accept_s) } s, ohne ihn beantwortet zu haben
sequence-effect_screen_lamp_name_colour = effect, screen, lamp:NAME=FARBE (oder off), angle:NAME=GRAD (oder MARKE)
sequence-file_name_characters_all_seen = Dateiname { $shown } mit { $name } Zeichen (Grenze { $limit }, alle sichtbar)
sequence-gesture_check_within_known = { $place }: { $found }; bekannt sind do (eine Geste), check und within_s
sequence-ids_given_sequencer = { $place }: { $gesture }: ids vergibt der Ablaufgeber
sequence-lamp_none = { $place }: Lampe { $found } ist keine von { $lamps }
sequence-machine_told_stop = { $given_up }; die Maschine sollte anhalten und meldet { $driver }
sequence-machine_told_stop_but_says = { $given_up }; die Maschine sollte anhalten, meldet aber { $driver }: bitte nachsehen
sequence-n_1_mapping_steps_needed = { $file_name }:1: nötig ist eine Zuordnung mit steps
sequence-name_characters_expected_up_printable = { $place }: der Name hat { $name } Zeichen; erlaubt sind höchstens { $max_name } druckbare
sequence-name_text_steps_list_known = { $place }: { $key }: bekannt sind name (ein Text) und steps (eine Liste)
sequence-neither_text_nor_mapping = { $place }: { $entry } ist weder ein Text noch eine Zuordnung
sequence-no_change = keine Änderung
sequence-no_gantry_controller_listens = keine Steuerung hört zu
sequence-no_gesture = keine Geste
sequence-no_lamp_seen_lamps_seen = an { $control } ist keine Lampe zu sehen; Lampen sind zu sehen an { $lit }
sequence-no_mark = keine Marke { $check }
sequence-no_sign_work = seit { SHORT($answer_timeout_s) } s kein Zeichen eines Fortschritts
sequence-not_looked = nicht danach geschaut
sequence-not_seen_time = nicht rechtzeitig zu sehen: { WORD($missing) }
sequence-not_seen_yet = noch nicht gesehen
sequence-only_knob_angle = { $control } ist: { WORD($kind) }; einen Winkel hat nur ein Drehknopf
sequence-panel_no_nearest = diese Front hat kein { $name }; am ähnlichsten: { $near }
sequence-panel_no_screen = diese Front hat keinen Bildschirm
sequence-sequencer_ending = der Ablaufgeber endet
sequence-sequencer_held_up = der Ablaufgeber stand { FIXED($held_up_s, digits: 1) } s lang still
sequence-step_running = Schritt { $number }/{ $steps }: { $gesture }
sequence-step_failed = Schritt { $number } von { $steps }, { $gesture }: { $cause }
sequence-place = Schritt { $number }
sequence-step_unfit = Schritt { $number }: { WORD($what) }
sequence-steps = { $steps } Schritte
sequence-steps_1_needed = { $entries } Schritte; nötig sind 1 bis { $max_steps }
sequence-unknown_key = unbekannter Schlüssel { $map }
sequence-within_seconds_above_0_up = { $place }: within_s = { $within }: nötig sind Sekunden über 0 bis 60

## servo

servo-seen_error_after_corrections_allowed = der gesehene Fehler ist nach { $corrections } Korrekturen { FIXED($sideways_mm, digits: 2) } mm (Grenze { SHORT($max_error_mm) } mm)
servo-seen_errors_add_up_correction = die gesehenen Fehler ergeben zusammen eine Korrektur um { FIXED($total_mm, digits: 2) } mm (Grenze { SHORT($most_mm) } mm)
servo-tip_seen_above_surface_when = die Spitze war { FIXED($above_mm, digits: 1) } mm über der Fläche zu sehen, als sie berühren sollte (Grenze { SHORT($max_depth_error_mm) } mm): geht der Stift herunter, ist das Bild neu?
servo-tip_seen_beside_above_place = die Spitze ist { FIXED($sideways_mm, digits: 2) } mm neben und { FIXED($error_mm, digits: 2, sign: 1) } mm über ihrer Stelle zu sehen (Grenze { SHORT($max_correction_m) } und { SHORT($max_depth_error_mm) } mm): neu kalibrieren
servo-tip_seen_times_times_within = die Kameras sahen die Spitze { $tips }-mal (mindestens { $needed }-mal innerhalb von { SHORT($spread_mm) } mm)
servo-touched_beside_target_allowed = { FIXED($error_mm, digits: 2) } mm neben dem Ziel berührt (Grenze { SHORT($bound_mm) } mm)
servo-touched_but_not_measured = berührt, aber nicht gemessen: { $unseen_text }

## settings

settings-not_kept = die Platine hat eine Einstellung nicht behalten: { $setting }
settings-became_write_back = ${ $n } ist jetzt { $settings }, war aber { $kept }: zurückschreiben
settings-bit_0_bit_5 = Bit 0 ({ $machine_position }) oder Bit 5 ({ $work_offset })
settings-board_no_settings = die Platine hat keine Einstellungen
settings-board_told_no_settings = die Platine hat keine Einstellungen gemeldet
settings-cannot_written = { WORD($value) } lässt sich nicht schreiben
settings-configuration = die Konfiguration
settings-could_not_read_noise_line = { WORD($missing) } war nicht zu lesen, ist die Leitung gestört? Was die Platine nach jedem Reset ausführt, ist nicht bekannt: neu verbinden
settings-line_given_twice = Zeile { $place }: ${ $number } steht zweimal da
settings-line_not_value = Zeile { $place }: { $text } ist nicht von der Form $Nummer=Wert
settings-line_not_within = Zeile { $place }: { $text } liegt nicht zwischen -{ SHORT($largest) } und { SHORT($largest_2) }
settings-missing_says = ${ $number } fehlt; erwartet { SHORT($value) } ({ $who })
settings-motors_let_go_can_pushed = ${ $idle_delay } ist { $idle }: Motoren ohne Strom verschieben sich unbemerkt, { $stays_on } lässt sie eingeschaltet
settings-nothing_accept_driver = nichts anzunehmen: der Treiber ist { $state_text }
settings-nothing_write = nichts zu schreiben: { $known }
settings-profile_no_setting = das Profil hat keine Einstellung
settings-reports_tell_no_machine_position = ${ $number } ist { $shown }: ihre Berichte nennen ohne { $lacks } keine Maschinenposition; erwartet { SHORT($value) } ({ $who })
settings-runs_after_each_reset_must = { $name } führt nach jedem Reset { $text } aus, muss aber leer sein: mit $X entsperren, dann { $name_2 }= senden
settings-runs_after_reset_must_empty = { $name } führt nach einem Reset { $text } aus, muss aber leer sein: aus der Konfigurationsdatei der Platine nehmen
settings-says = ${ $number } ist { $text }; erwartet { SHORT($value) } ({ $who })
settings-settings_written_board_rest_stylus = der Treiber schreibt Einstellungen nur, wenn die Platine ruht und der Stift oben ist; er ist { $state_text }
settings-these_settings = sie hat diese Einstellungen schon
settings-writing = schreibt { $lines }
settings-written = das Geschriebene

## sources

sources-no_known_program = keinem bekannten Programm
sources-no_program = kein Programm
sources-program_without_name = ein Programm ohne Namen
sources-programs_publish = { $count } Programme veröffentlichen { $topic }: { $listed }
sources-times = { $name } ({ $count }-mal)
sources-trajectory_programs_allows = von { $found }: trajectory_programs erlaubt { $allowed }

## state

state-because = { state-named }: { $reason }
state-named = { $state ->
    [disconnected] getrennt
    [connecting] verbindet
    [unhomed] ohne Referenz
    [homing] Referenzfahrt
    [disabled] gesperrt
    [idle] ruht
    [moving] bewegt sich
    [stopped] gestoppt
    [stopping] hält an
    [alarm] Alarm
    [mismatch] falsch eingestellt
    [waiting] wartet
    [ready] bereit
    [looking] schaut
    [touching] berührt
    [uncalibrated] unkalibriert
    [calibrating] kalibriert gerade
    [calibrated] kalibriert
    [failed] misslungen
    [inactive] nicht aktiv
   *[other] { $state }
}

## stereo

stereo-left_right_images_differ_tolerance = linkes und rechtes Bild liegen { FIXED($apart_ms, digits: 1) } ms auseinander (Grenze { SHORT($tolerance_ms) } ms): pair_tolerance_s einstellen, denn eine ruhende Front sieht in beiden gleich aus

## still

still-machine_not_stood_still = die Maschine hat noch keine { SHORT($settle_s) } s lang stillgestanden
still-no_joint_states_arrive = es kommen keine Gelenkwerte
still-tip_scatters_accepted = die Spitze streut um { FIXED($scatter_mm, digits: 2) } mm (Grenze { FIXED($scatter_2_mm, digits: 2) } mm)

## stop

stop-after = { $text }, davor: { $reason }
stop-after_reset_board_reports_mpos = nach dem Zurücksetzen meldet die Platine MPos { $found_mm } mm statt { $stood_mm } mm, ihre Position ist verloren
stop-board_locked_alarm_whose_number = die Platine ist durch einen Alarm gesperrt, dessen Nummer nicht ankam
stop-board_without_command_here = die Platine ist ohne einen Befehl von hier in { $state_text }
stop-nothing_reset_driver = nichts zurückzusetzen: der Treiber ist { $state_text }
stop-reset_left_board_locked_position = nach dem Zurücksetzen ist die Platine gesperrt, ihre Position ist verloren
stop-stop_not_complete_yet = der Stop ist noch nicht zu Ende
stop-stylus_left_down_while_no = der Stift blieb unten, während kein Treiber verbunden war
stop-stylus_not_lifted_still_extended = die Platine hat den Stift nicht gehoben: er ist noch { FIXED($extension_mm, digits: 1) } mm ausgefahren

## stream

stream-board_not_told_work_offset = die Platine hat ihren Werkstückversatz (WCO) noch nicht gemeldet
stream-board_not_told_work_offset_2 = die Platine hat ihren Werkstückversatz (WCO) noch nicht zweimal gleich gemeldet
stream-board_went = die Platine ging in { $state_text }
stream-driver_inactive = der Treiber ist nicht aktiv
stream-no_operator_heartbeat_yet = bisher kein Herzschlag des Bedieners
stream-nothing_pause_driver = nichts anzuhalten: der Treiber ist { $state_text }
stream-nothing_resume_driver = nichts fortzusetzen: der Treiber ist { $state_text }
stream-operator_heartbeat_lost_old_allowed = der Herzschlag des Bedieners blieb aus: { FIXED($age_s, digits: 2) } s alt (Grenze { SHORT($heartbeat_timeout_s) } s)
stream-place_work_offset_changed_since = Ort oder Werkstückversatz haben sich seit der Prüfung des Programms geändert
stream-program_lines_about = Programm mit { $checked } Zeilen, etwa { FIXED($seconds_s, digits: 1) } s
stream-stale_stamp_old_allowed = veraltet: der Stempel ist { FIXED($age_s, digits: 3) } s alt (Grenze { SHORT($limit_s) } s)
stream-trajectory_driver = Bahn beim Treiber

## stylus

stylus-extended = der Stift ist um { FIXED($extended_mm, digits: 1) } mm ausgefahren
stylus-down = der Stift ist unten
stylus-servo_may_without_pulses_sink = der Servo ist vielleicht ohne Impulse und sinkt, der Stift drückt dann vielleicht
stylus-solenoid_without_power_stylus_up = der Hubmagnet ist stromlos, der Stift ist oben
stylus-stylus_not_lifted_may_still = die Platine hat den Stift nicht gehoben, er drückt vielleicht noch

## target

target-bare_face = die bloße Front
target-connectors_never_pressed = { $control } ist: { WORD($kind) }; der Stift drückt keine Buchsen
target-dimple_wide_stylus_needs_more = die Mulde von { $control } ist { SHORT($diameter_mm) } mm weit, der Stift braucht mehr als { FIXED($wide_mm, digits: 1) } mm, um den Grund zu erreichen
target-drag_begins_ends_must_stay = das Ziehen beginnt auf { $control } und endet auf { $name }; es muss auf einem bleiben
target-drag_begins_only_touch_area = das Ziehen beginnt auf { $name }; ziehen geht nur auf einem Berührbildschirm
target-only_knob_can_turned = { $control } ist: { WORD($kind) }; drehen geht nur mit einem Drehknopf
target-only_knob_can_turned_no = drehen geht nur mit einem Drehknopf, und an dieser Stelle ist kein Element
target-panel_leans_degrees_most_allowed = die Front ist um { FIXED($tilt_deg, digits: 1) } Grad geneigt (Grenze { SHORT($max_tilt_deg) })
target-pixel_lies_outside_picture = Bildpunkt ({ SHORT($x) }; { SHORT($y) }) liegt außerhalb des Bildes mit { $width } x { $height }
target-point_beside_high_needed = die Stelle liegt { FIXED($gap_mm, digits: 1) } mm neben { $other } ({ FIXED($height_mm, digits: 0) } mm hoch), mindestens { FIXED($needed_mm, digits: 1) } mm
target-point_lies_outside_panel = der Punkt ({ FIXED($point, digits: 4) }; { FIXED($point_2, digits: 4) }) m in { $panel } liegt außerhalb der Front, ({ FIXED($low, digits: 3) }; { FIXED($low_2, digits: 3) }) bis ({ FIXED($high, digits: 3) }; { FIXED($high_2, digits: 3) }) m
target-stylus_degrees_play_dimple_most = der Stift hat { FIXED($play_deg, digits: 1) } Grad Spiel in der Mulde von { $control }, höchstens { SHORT($most_bias_deg) } sind auszugleichen
target-touch_needs_extension_stylus_reaches = die Berührung braucht { FIXED($touch_z_m, digits: 4) } m Weg, der Stift reicht { FIXED($down_m, digits: 4) } m
target-turned_dimple_found_marker_turn = der Stift dreht { $control } in der Mulde, die er an der Marke erkennt: mit dem Namen drehen

## teach

teach-not_understood = die Anfrage ist nicht verständlich: { $kind }: { $error }
teach-already_remove_choose_another_model = { $path } gibt es schon; entfernen oder ein anderes Modell wählen
teach-another_panel_taught_before_picture = ein Auftrag für eine andere Front kam vor dem Bild von { $stamp_ns }
teach-cannot_encoded = { $template } lässt sich nicht speichern
teach-control_kind_none = Element { $control }: Art { WORD($kind) } ist keine von { $control_kinds }
teach-control_name_kind_widthxheight_height = Element { $text }: nötig ist NAME:Art:u,v:BREITExHÖHE[:Überstand]
teach-corners_not_go_round_face = die Ecken { $corners } gehen nicht um die Front herum: unten links, unten rechts, oben rechts, oben links
teach-error_while_teaching = Fehler beim Anlernen: { $error }
teach-four_corners_needed = { $corners }: nötig sind vier Ecken u,v
teach-model_letter_then_up_40 = Modell { $model }: nötig ist ein Buchstabe, dann bis zu 40 Buchstaben, Ziffern und '_'
teach-picture_did_not_come_within = das Bild von { $stamp_ns } kam nicht innerhalb von { SHORT($picture_wait_s) } s
teach-pixel_beyond_camera_calibration_reaches = Pixel { FIXED($u, digits: 0) }, { FIXED($v, digits: 0) } liegt außerhalb dessen, was die Kalibrierung der Kamera erreicht
teach-request_not_understood_more_characters = die Anfrage ist unlesbar: mehr als { $max_request } Zeichen oder { $max_depth } Klammern
teach-sides_48_8192_needed = { FIXED($wide, digits: 0) } x { FIXED($high_px, digits: 0) } px bei { SHORT($px_per_mm) } px/mm: nötig sind Seiten von 48 bis 8192 px
teach-teach_folder_not_set_nowhere = teach_folder ist nicht gesetzt: es gibt keinen Ort für eine Beschreibung
teach-wrote = geschrieben: { $layout } und { $template }

## template

template-sides_16_8192_needed = { $width } x { $height_px } px bei { SHORT($px_per_mm) } px/mm: nötig sind Seiten von 16 bis 8192 px
template-template_picture_layout = das Vorlagenbild hat { $found } x { $found_px } px, die { SHORT($size_mm) } x { SHORT($size_2_mm) } mm der Beschreibung sind bei { SHORT($picture_px_per_mm) } px/mm { FIXED($wanted, digits: 0) } x { FIXED($wanted_px, digits: 0) } px

## text

text-more = { $first }: { $second }
text-and_also = { $first }; { $second }
text-both = { WORD($first) } und { WORD($second) }
text-listed = { $first }, { $second }
text-quoted = '{ $text }'

## tips

tips-left_right_images_differ_tolerance = linkes und rechtes Bild liegen { FIXED($difference_ms, digits: 1) } ms auseinander (Grenze { SHORT($tolerance_ms) } ms): { $parameter } einstellen
tips-right_image_before_not_show = das rechte Bild davor zeigt die Kugel nicht
tips-rows_differ_above_left_image = die Zeilen unterscheiden sich zum Zeitpunkt des linken Bildes um { FIXED($rows_px, digits: 2) } px (Grenze { SHORT($row_limit_px) })

## tour

tour-above = x von oben
tour-above_2 = y von oben
tour-below = x von unten
tour-below_2 = y von unten

## views

views-board_not_seen_both_cameras = die Tafel ist nicht in beiden Kameras zu sehen
views-board_not_seen_whole = die Tafel ist nicht ganz zu sehen
views-both_cameras_pictures_apart_most = die Bilder der beiden Kameras liegen { FIXED($best_ms, digits: 1) } ms auseinander, höchstens { SHORT($most) } gelten als ein Augenblick
views-hold_board_differently = die Tafel anders halten
views-hold_board_still = die Tafel still halten
views-no_pictures_yet = noch keine Bilder
views-picture_refused = Bild abgelehnt: { $error }
views-show_board = die Tafel zeigen
views-show_board_farther_away = die Tafel von weiter weg zeigen
views-show_board_nearer_filling_half = die Tafel von näher zeigen, sodass sie das halbe Bild füllt
views-show_board_nearer_picture_edge = die Tafel näher am { WORD($needed) } Bildrand zeigen
views-tilt_board_20_45_degrees = die Tafel um 20 bis 45 Grad in verschiedene Richtungen neigen ({ $tilted } von 4 Ansichten)
views-views = { $kept }/{ $wanted } Ansichten

## wait

wait-for_s = seit { FIXED($age_s, digits: 1) } s
wait-image_left_camera = Bild der linken Kamera

## yaml

yaml-characters = { $key } = { WORD($value) }..., { $value_2 } Zeichen
yaml-colour_such_ff_8800_needed = { $key } = { WORD($value) }: nötig ist eine Farbe wie "#ff8800"
yaml-expected_key_value = { $pair }: erwartet KEY=VALUE
yaml-expected_up_printable_characters = { $found }: erlaubt sind höchstens { $max_text } druckbare Zeichen
yaml-key_stands_twice = Schlüssel { $key } steht zweimal da
yaml-more_levels = mehr als { $max_depth } Ebenen
yaml-more_open_brackets = mehr als { $max_depth } offene Klammern
yaml-more_values = mehr als { $max_nodes } Werte
yaml-must_list_mappings = { $key } muss eine Liste von Zuordnungen sein
yaml-none = { $key } = { WORD($value) } ist keines von { $choices }
yaml-numbers_needed = { $key } = { WORD($value) }: nötig sind { $count } Zahlen
yaml-numbers_up_10000_needed = { $key } = { WORD($value) }: nötig sind { $value_2 }Zahlen bis 10000
yaml-text_bytes_limit = der Text hat { $size } Bytes (Grenze { $max_bytes })
yaml-text_needed_quote = { $key } = { WORD($value) }: nötig ist ein Text (in Anführungszeichen)
yaml-unknown_key_known = unbekannter Schlüssel { $map }; bekannt: { $names }
yaml-value_cannot_read = { $pair }: der Wert ist nicht lesbar

## envelope

envelope-sideways = der Weg führt mit ausgefahrenem Stift { FIXED($measured_mm, digits: 1) } mm zur Seite (Grenze { FIXED($limit_mm, digits: 1) } mm)
envelope-too_low = der Weg führt { FIXED($measured_mm, digits: 1) } mm über der Front zur Seite (Grenze { FIXED($limit_mm, digits: 1) } mm)
envelope-too_deep = der Weg führt { FIXED($measured_mm, digits: 1) } mm hinter die Front (Grenze { FIXED($limit_mm, digits: 1) } mm)
envelope-old_panel = die Ebene der Front ist { FIXED($age_s, digits: 1) } s alt (Grenze { FIXED($limit_s, digits: 1) } s)
envelope-no_panel = die Ebene der Front ist nicht bekannt: der Stift käme { FIXED($measured_mm, digits: 1) } mm weit heraus (Grenze { FIXED($limit_mm, digits: 1) } mm)

## Wörter, die als Werte in Sätzen stehen

word-left = linken
word-right = rechten
word-red = rot
word-green = grün
word-off = aus
word-yellow = gelb
word-amber = bernsteinfarben
word-cyan = türkis
word-blue = blau
word-violet = violett
word-white = weiß
word-stylus = Stift
word-something = etwas
word-edge = Bildrand
word-goal = Ziel
word-command = Befehl
word-accepted = angenommen
word-rejected = abgelehnt
word-aborted = abgebrochen
word-reached = erreicht
word-answered = beantwortet
word-knob = Drehknopf
word-button = Taste
word-connector = Buchse
word-touch_area = Berührbildschirm
word-fixed = fest
word-carriage = auf dem Wagen
word-pose = Lage
word-controls = Bedienelemente
word-panel = Front
word-tip = Spitze
word-nearer = näher
word-upper = oberen
word-lower = unteren
word-circle = Kreis
word-rectangle = Rechteck
